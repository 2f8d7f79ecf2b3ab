"""A machine set up by measured numbers, calibrated by weighed loads, judged by the loads after them; the truth is hidden.

The forces come from the virtual combine's throws, which share no code with the monitor's model. Hidden are: the force cell's gain
(13 % off the shipped one, found by hung weights), the plate's angle (1.5 deg off what the actuator reports, found by an
inclinometer), the grain (density 18 % off the shipped crop, friction and restitution drawn with their standard deviations) and
the geometry (longer paddles, another plate, measured with a tape).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.facility.facility import window_sigma_n
from studies.facility.mean_force import shown_force_n, true_angle_rad
from yieldmon.cli._setup import derive
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep
from yieldmon.estimation.weighing.load_departures import departure
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.estimation.weighing.loads import calibrate_loads
from yieldmon.files.crops import crop
from yieldmon.physics.machine import RPM, ImpactSensor, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.effects import Effects, Gravity, PlateAngleOffset
from yieldmon.plant.grain import Grain
from yieldmon.plant.profiles import correlated_noise
from yieldmon.plant.pulse_table import SEASON, Condition, PulseTable
from yieldmon.plant.scenario import Scenario
from yieldmon.units import N_PER_KGF

Array = NDArray[np.float64]

TICKET_SD = 0.003
LOAD_FLOWS = ((3.5, 6.0), (9.0, 13.0), (16.0, 21.0), (5.0, 9.0), (12.0, 17.0), (18.0, 22.0))
"""Of the weighed loads, drawn between these, kg/s: as different as the field allows."""
NEXT_LOADS = 10
SCATTER = 0.02
"""Relative standard deviation of one second's mean force by the paddles' scatter, as the monitor's windows state it."""
_EXACT = 1e-6


@dataclass(frozen=True)
class Combine:
    """The hidden truth. machine: true geometry and gain."""

    machine: Machine
    effects: Effects
    table: PulseTable
    scenario: Scenario

    def load(self, kg: float, flow_kg_s: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Flow kg/s, force N at the true cell and elevator speed rad/s of each second of a load of about `kg`."""
        count = max(int(kg / flow_kg_s), 60)
        flow = np.clip(flow_kg_s * (1.0 + 0.18 * correlated_noise(count, 30.0, rng)), 0.4 * flow_kg_s, min(1.5 * flow_kg_s, 25.0))
        speed = 400.0 * RPM * (1.0 - 0.03 * flow / 25.0) * (1.0 + 0.003 * correlated_noise(count, 5.0, rng))
        return flow, self.force(flow, np.full(count, self.machine.home_plate_angle_rad), speed, rng), speed

    def force(self, flow: Array, reported_rad: Array, speed: Array, rng: np.random.Generator) -> Array:
        """Mean force of each second, N at the true cell, with paddle scatter, electrical noise and what zeroing leaves."""
        mean = shown_force_n(self.table, self.effects, flow, reported_rad, speed, self.scenario.sensor.response_s)
        sigma = window_sigma_n(self.table, self.scenario, flow, true_angle_rad(self.effects, reported_rad), speed, 1.0)
        return mean + sigma * rng.standard_normal(flow.size) + 0.1 * correlated_noise(flow.size, 600.0, rng)


def _drawn(rng: np.random.Generator) -> float:
    """Standard normal; what lies further out than twice the standard deviation is drawn again, for want of such grain."""
    while abs(value := float(rng.standard_normal())) > 2.0:
        pass
    return value


def combine(rng: np.random.Generator) -> Combine:
    """A machine, its grain and its plate."""
    machine = replace(
        Machine(),
        name="hidden",
        paddle_length_m=0.168,
        paddle_width_m=0.225,
        plate_pivot_x_m=0.425,
        plate_pivot_y_m=-0.17,
        plate_length_m=0.2,
        sensor=ImpactSensor(0.4448 * 1.13, 4000.0),
    )
    shipped = crop("corn")
    grain = Grain(
        shipped.friction + shipped.friction_sd * _drawn(rng),
        shipped.restitution + shipped.restitution_sd * _drawn(rng),
        crop("corn").parameters().values["density"] * rng.choice([0.82, 1.18]),
        2.0,
        15.0,
    )
    effects = Effects(gravity=Gravity(), plate_angle_offset=PlateAngleOffset(angle_deg=float(rng.choice([-1.5, 1.5]))))
    return Combine(machine, effects, PulseTable(machine, [Condition(0.0, grain, effects)], SEASON), Scenario())


def answers(truth: Combine, rng: np.random.Generator) -> dict[str, Any]:
    """What a person with a tape (1 mm), an inclinometer (0.2 deg), weights and a voltmeter (0.5 mV) writes down."""
    machine = truth.machine
    offset = truth.effects.plate_angle_offset
    assert offset is not None

    def tape(metres: float) -> float:
        return round(metres + 0.001 * rng.standard_normal(), 4)

    weights = [0.0, 5.0, 10.0]
    gain = machine.sensor.gain_n_per_mv
    readings = [500.0 + N_PER_KGF * kg / gain + 0.5 * rng.standard_normal() for kg in weights]
    reported = [45.0, 85.0]
    return {
        "machine_name": "hidden",
        "sprocket_pitch_radius_m": round(machine.sprocket_pitch_radius_m + 2e-4 * rng.standard_normal(), 4),
        "paddle_spacings_m": list(machine.paddle_spacings_m),
        "paddle_length_m": tape(machine.paddle_length_m),
        "paddle_width_m": tape(machine.paddle_width_m),
        "plate_pivot_x_m": tape(machine.plate_pivot_x_m),
        "plate_pivot_above_m": tape(-machine.plate_pivot_y_m),
        "plate_length_m": tape(machine.plate_length_m),
        "home_plate_angle_deg": 70.0,
        "min_plate_angle_deg": 40.0,
        "max_plate_angle_deg": 90.0,
        "nominal_elevator_speed_rpm": 400.0,
        "min_elevator_speed_rpm": 250.0,
        "max_elevator_speed_rpm": 599.0,
        "largest_flow_kg_s": 25.0,
        "cell_full_scale_mv": 4000.0,
        "cell_weights_kg": weights,
        "cell_readings_mv": readings,
        "plate_measured_deg": [r + offset.angle_deg + 0.2 * rng.standard_normal() for r in reported],
        "plate_reported_deg": reported,
        "crop": "corn",
    }


@dataclass(frozen=True)
class Result:
    """One seed and one way. errors: relative, of the next loads, %. sd: stated for a next load, %. own_sd: of each of these loads
    by the parameters' covariance and its own scatter, %."""

    seed: int
    way: str
    errors_pct: tuple[float, ...]
    sd_pct: float
    own_sd_pct: tuple[float, ...]


def run(seed: int, *, with_sweeps: bool = True) -> list[Result]:
    """Set-up alone, then three and six loads, without and with sweeps."""
    rng = np.random.default_rng([20261122, seed])
    truth = combine(rng)
    said = answers(truth, rng)
    machine, prior = derive.machine(said), derive.parameters(said)
    cell = machine.sensor.gain_n_per_mv / truth.machine.sensor.gain_n_per_mv
    model = ForwardModel(machine, prior.effects)
    shipped, home = OpenLoop(model, prior), machine.home_plate_angle_rad
    weighed = []
    for number, (low, high) in enumerate(LOAD_FLOWS, 1):
        flow, force, speed = truth.load(rng.uniform(2000.0, 9000.0), rng.uniform(low, high), rng)
        kg = float(flow.sum())
        weighed.append(
            WeighedLoad(
                str(number),
                kg * (1.0 + TICKET_SD * rng.standard_normal()),
                TICKET_SD * kg,
                np.ones(flow.size),
                force * cell,
                np.full(flow.size, home),
                speed,
                noise_sd=noise_sd(shipped, force * cell, speed),
            )
        )
    sweeps = [_sweep(truth, machine, cell, rng) for _ in range(8)]
    judged = [truth.load(rng.uniform(2000.0, 9000.0), rng.uniform(3.0, 22.0), rng) for _ in range(NEXT_LOADS)]
    ways = {
        "set-up alone": None,
        "three loads": calibrate_loads(model, prior, weighed[:3]),
        "six loads": calibrate_loads(model, prior, weighed),
    }
    if with_sweeps:
        ways["three loads and sweeps"] = calibrate_loads(model, prior, weighed[:3], sweeps=sweeps)
        ways["six loads and sweeps"] = calibrate_loads(model, prior, weighed, sweeps=sweeps)
    results = []
    for way, found in ways.items():
        known = prior if found is None else found.parameter_set
        loop = OpenLoop(model, known)
        errors, deviations = [], []
        for flow, force, speed in judged:
            angle, kg = np.full(flow.size, home), float(flow.sum())
            measured = float(np.nansum(loop.invert(force * cell, angle, speed)))
            errors.append(100.0 * (measured / kg - 1.0))
            noise = noise_sd(loop, force * cell, speed)
            exact = WeighedLoad("", kg, _EXACT * kg, np.ones(flow.size), force * cell, angle, speed, noise_sd=noise)
            deviations.append(100.0 * departure(model, known, exact)[1])
        stated = float("nan") if found is None else 100.0 * found.next_load_sd
        results.append(Result(seed, way, tuple(errors), stated, tuple(deviations)))
    return results


def noise_sd(loop: OpenLoop, force_n: Array, speed_rad_s: Array) -> float:
    """Relative standard deviation of a load's mass by the scatter of its seconds at home, as the monitor states it."""
    home = loop.model.machine.home_plate_angle_rad
    found = loop.estimate(force_n, home, speed_rad_s, SCATTER * force_n)
    assert found.noise_std_dev_kg_s is not None
    return float(np.sqrt(np.nansum(found.noise_std_dev_kg_s**2)) / np.nansum(found.mass_flow_kg_s))


def _sweep(truth: Combine, machine: Machine, cell: float, rng: np.random.Generator) -> Sweep:
    """One sweep at steady flow: every angle twice, home between."""
    angles = np.radians(np.repeat([70.0, 40.0, 40.0, 70.0, 50.0, 60.0, 70.0, 80.0, 90.0, 70.0], 2))
    flow = rng.uniform(6.0, 18.0) * (1.0 + 0.02 * correlated_noise(angles.size, 20.0, rng))
    speed = np.full(angles.size, 400.0 * RPM)
    force = truth.force(flow, angles, speed, rng) * cell
    return Sweep(np.arange(angles.size, dtype=float), angles, speed, force, 0.03 * force)
