"""What sweeps do to a machine that starts with a fleet's prior, before and after its first weighed loads.

    python -m studies.fleet_prior --sweeps [--seeds N] [--machines N] [--json]

The draws are those of the study, and all machines hide one effect that the estimator's model does not have. A machine's first two
loads are its tickets; it is judged by the others. Each sweep holds the plate at eleven places, 1 % from window to window by the
feed and 0.5 % by noise, and goes through the daemon's own calibrator with its defaults.

- prior: the fleet's prior, no sweep.
- sweeps: eight sweeps, read with the prior's own covariance, until they have shown that the model disagrees.
- sweeps and angle: the same with the plate's angle as a parameter beside, 0 ± 1 deg, as it is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import nan
from typing import Any

import numpy as np

from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.self_calibration.load_forces import LoadForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.engine.sweeps.disagreement import Disagreement
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.weighing.fleet_prior import MachineLoads, load_errors, pooled
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.files.crops import crop
from yieldmon.frames import EstimateQuality, OperatingState
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.resources import shipped as shipped_file
from yieldmon.service.config import configuration
from yieldmon.service.config.configuration import Configuration

from .draws import ANGLE_SD_DEG, CROPS, SCATTER_SD, Hidden, drawn, hidden_crop, mean_std_dev

HIDDEN: dict[str, dict[str, float]] = {
    "as modelled": {},
    "plate friction 0.15": {"plate_friction.coefficient": 0.15},
    "heap half as steep again": {"heap_shape.change": 0.5},
    "radial speed 0.15": {"residual_radial_speed.share": 0.15},
}
ANGLE = "plate_angle_offset.angle_rad"
SWEEPS, TICKETS = 8, 2
_PLACES_DEG = (70, 40, 70, 50, 70, 60, 70, 80, 70, 90, 70)
_A_PLACE, _FEED_SD, _NOISE_SD = 4, 0.01, 0.005
_SWEEP_S, _WINDOW_S, _LOAD_S = 2400.0, 1.5, 600.0
_ANGLE_SD_RAD = np.radians(ANGLE_SD_DEG)


@dataclass(frozen=True)
class _Way:
    """How a machine begins: with sweeps or without, the plate's angle a parameter or not, its tickets first or not."""

    sweeps: bool
    angle: bool
    tickets: bool


WAYS = {
    "prior": _Way(sweeps=False, angle=False, tickets=False),
    "sweeps": _Way(sweeps=True, angle=False, tickets=False),
    "sweeps and angle": _Way(sweeps=True, angle=True, tickets=False),
    "tickets": _Way(sweeps=False, angle=False, tickets=True),
    "tickets, sweeps": _Way(sweeps=True, angle=False, tickets=True),
    "tickets, sweeps and angle": _Way(sweeps=True, angle=True, tickets=True),
}


def sweep(hidden: Hidden, chance: np.random.Generator, start_s: float) -> list[WindowRecord]:
    """The windows of a sweep on a machine, from start_s on."""
    machine = Machine()
    at_rad = np.radians(np.repeat(_PLACES_DEG, _A_PLACE).astype(float))
    speed = np.full(at_rad.size, machine.nominal_elevator_speed_rad_s)
    flow = chance.uniform(6.0, 12.0) * np.exp(chance.normal(0.0, _FEED_SD, at_rad.size))
    force = hidden.force(at_rad, speed, flow) * np.exp(chance.normal(0.0, _NOISE_SD, at_rad.size))
    columns = zip(force.tolist(), at_rad.tolist(), flow.tolist(), strict=True)
    return [_window(start_s, place, *values) for place, values in enumerate(columns)]


def _window(start_s: float, place: int, force_n: float, at_rad: float, flow_kg_s: float) -> WindowRecord:
    time_s = start_s + _WINDOW_S * place
    return WindowRecord(
        time_s=time_s, window=place, duration_s=1.0, coverage=1.0, force_n=force_n,
        force_std_dev_n=float(np.hypot(_NOISE_SD, _FEED_SD)) * force_n,
        elevator_speed_rad_s=Machine().nominal_elevator_speed_rad_s, plate_angle_rad=at_rad, plate_still=True,
        moisture_pct=nan, test_weight_kg_m3=nan, mass_flow_kg_s=flow_kg_s, std_dev_kg_s=0.1,
        quality=EstimateQuality.SWEEPING, operating_state=OperatingState.SWEEPING, mass_kg=flow_kg_s, load_kg=0.0,
        total_kg=10.0 * time_s, load_number=1, zero_mv=0.0, pulse_mv=50.0, saturated_share=0.0, lost_frames=0,
        surplus_frames=0, repeated_frames=0, sweep_id=1, sweep_step=place, usable_for_calibration=True, parameter_version=1,
        faults=(), latitude_deg=nan, longitude_deg=nan, ground_speed_m_s=nan, course_deg=nan,
    )  # fmt: skip


def with_angle(prior: ParameterSet) -> ParameterSet:
    """The set with the plate's angle as a parameter of its own, independent of the others."""
    size = len(prior.covariance_names)
    covariance = np.zeros((size + 1, size + 1))
    covariance[:size, :size], covariance[size, size] = prior.covariance, _ANGLE_SD_RAD**2
    values = {**prior.values, ANGLE: 0.0}
    return replace(prior, values=values, covariance_names=(*prior.covariance_names, ANGLE), covariance=covariance)


def after(
    way: _Way, prior: ParameterSet, sweeps: Sequence[list[WindowRecord]], tickets: Sequence[WeighedLoad]
) -> tuple[ParameterSet, float]:
    """What the daemon makes of the prior, and the relative standard deviation of the model at home that its sweeps have shown
    and it states beside the parameters' own."""
    known = with_angle(prior) if way.angle else prior
    loaded = _loaded()
    assert loaded.calibrator is not None
    calibrator = ClosedLoopCalibrator(ForwardModel(loaded.machine, known.effects), loaded.calibrator)
    disagreement = Disagreement(loaded.engine.disagreement, loaded.machine)
    estimator: Any = OpenLoop(ForwardModel(loaded.machine, known.effects), known)
    entered: tuple[ReferenceMass, ...] = ()
    for number, load in enumerate(tickets if way.tickets else (), 1):
        entered = (*entered, _ticket(estimator, load, number))
        estimator = calibrator.weigh(_at(sweeps[0][0], number), entered, estimator).estimator or estimator
    for windows in sweeps if way.sweeps else ():
        disagreement.add(windows, estimator.parameters)
        estimator = calibrator.update(windows, estimator, use_sweep=not disagreement.present).estimator or estimator
    found: ParameterSet = estimator.parameters
    shown = way.sweeps and not way.tickets
    return found, disagreement.model_error(found).home if shown else 0.0


@cache
def _loaded() -> Configuration:
    return configuration.load(shipped_file("config/yieldmon.yaml"))


def _at(window: WindowRecord, number: int) -> WindowRecord:
    time_s = _SWEEP_S + _LOAD_S * number
    return replace(window, time_s=time_s, total_kg=10.0 * time_s)


def _ticket(estimator: OpenLoop, load: WeighedLoad, number: int) -> ReferenceMass:
    flow = estimator.estimate(load.force_n, load.plate_angle_rad, load.elevator_speed_rad_s).mass_flow_kg_s
    end_s = _SWEEP_S + _LOAD_S * number
    forces = LoadForces(
        load.duration_s, load.force_n, load.plate_angle_rad, load.elevator_speed_rad_s, np.full(load.force_n.shape, nan)
    )
    return ReferenceMass(
        ReferenceSource.TICKET, end_s - _LOAD_S, end_s, load.weighed_kg, load.std_dev_kg, float(load.duration_s @ flow), True,
        load_number=number, forces=forces,
    )  # fmt: skip


def judged(known: ParameterSet, home_error: float, loads: Sequence[WeighedLoad]) -> tuple[float, float]:
    """Mean absolute error of the loads, %, and z of their mean. home_error: as `after` has it."""
    model, condensed = ForwardModel(Machine(), known.effects), [load.condensed for load in loads]
    errors: Array = load_errors(model, known, condensed)
    std_dev = mean_std_dev(model, known, condensed)
    z = float(np.mean(errors)) / float(np.hypot(np.hypot(std_dev, home_error), SCATTER_SD / np.sqrt(len(loads))))
    return 100.0 * float(np.mean(np.abs(np.expm1(errors)))), z


def compare(hidden: dict[str, float], seeds: Sequence[int], machines: int) -> dict[str, dict[str, float]]:
    """Mean absolute error of a load, %, and root mean square z of a machine's, for each way; machines: of each crop."""
    found: dict[str, list[tuple[float, float]]] = {way: [] for way in WAYS}
    for seed in seeds:
        chance = np.random.default_rng(seed)
        for of_crop, name in enumerate(CROPS):
            shipped = crop(name).parameters()
            truth = hidden_crop(shipped, chance)
            fleet = [drawn(f"{name}-{k}", truth, chance, effects=hidden) for k in range(machines)]
            for number, (machine, own) in enumerate(fleet):
                if len(machine.loads) <= TICKETS:
                    continue
                others: list[MachineLoads] = [other for other, _ in fleet if other is not machine]
                prior = pooled(shipped, others).parameter_set
                draws = np.random.default_rng([seed, of_crop, number])
                sweeps = [sweep(own, draws, 1e4 + _SWEEP_S * count) for count in range(SWEEPS)]
                for way, how in WAYS.items():
                    found[way].append(judged(*after(how, prior, sweeps, machine.loads[:TICKETS]), machine.loads[TICKETS:]))
    return {
        way: {"error_pct": float(np.mean([e for e, _ in each])), "z": float(np.sqrt(np.mean([z * z for _, z in each])))}
        for way, each in found.items()
    }
