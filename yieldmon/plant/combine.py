"""The virtual combine: frames as the real machine's nodes would send them, and the truth behind them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import floor
from types import NoneType

import numpy as np
import scipy
from numpy.typing import ArrayLike

from yieldmon import frames
from yieldmon.arguments import require_type
from yieldmon.frames import Frame
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.numerics import Array
from yieldmon.plant import elevator, kernels, profiles, sensor
from yieldmon.plant.actuator import ActuatorFault, PlateActuator
from yieldmon.plant.crop_course import CropCourse
from yieldmon.plant.flight import GRAVITY_M_S2
from yieldmon.plant.nodes import BLOCK_SAMPLES, Nodes, sensor_fault
from yieldmon.plant.pulse_table import QUANTILES, Condition, Detail, PulseTable
from yieldmon.plant.scenario import Scenario
from yieldmon.plant.sensor import ImpactCell
from yieldmon.plant.tank import Load, Tank

BLOCK_S = 0.02
"""Commands take effect at the start of the next block."""

_CHUNK_SAMPLES = 1000
_PULSE_ROOM = 400
"""Samples ahead of a block into which its paddles' pulses may reach."""

_KERNEL_STEPS = 20
"""Steps of a sample in which kernels strike, so that a fast cell's response is followed."""

_MOISTURE_NODES = 5
_CHANGING = Detail(masses=26, angles_deg=(36.0, 94.0, 12), speeds_rpm=(240.0, 620.0, 8), cells=96)
_FINE = replace(_CHANGING, layers=28)
"""For kernels, whose noise a fast cell shows: the edges of few layers would stand above it at 300 to 450 Hz, where a stream of
grain (discrete elements) has nothing."""

TRUTH_COLUMNS = {
    "time_s": "end of the second",
    "mass_flow_kg_s": "mass past the plate in that second",
    "total_mass_kg": "mass past the plate since the start",
    "tank_mass_kg": "mass in the tank",
    "plate_angle_deg": "mean true plate angle, offset included",
    "elevator_speed_rpm": "mean true sprocket speed",
    "force_n": "mean horizontal force of the grain on the plate, scatter included, noise not",
    "zero_mv": "mean voltage of the cell without grain or vibration",
    "moisture_pct": "true grain moisture",
    "working": "1 with the header in the crop",
    "load_number": "loads emptied so far",
}


@dataclass(frozen=True, slots=True)
class Samples:
    """A stretch of 1 kHz samples: time of each (s), voltage (mV), and the true plate angle (deg) and sprocket speed (rad/s)."""

    time_s: Array
    sample_mv: Array
    plate_angle_deg: Array
    speed_rad_s: Array


@dataclass(frozen=True, slots=True)
class Truth:
    """What really happened: one row a second in columns TRUTH_COLUMNS, the loads emptied, and every paddle so far.

    paddles: columns time_s, mass_kg, impulse_n_s (with scatter), plate_angle_deg.
    """

    columns: dict[str, Array]
    loads: Sequence[Load]
    paddles: dict[str, Array]


def pulse_table(scenario: Scenario, machine: Machine) -> PulseTable:
    """Pulses of a scenario's crop and machine; the same table for the same crop, effects and machine."""
    crop, effects = scenario.crop, scenario.effects
    end = crop.moisture_pct if crop.end_moisture_pct is None else crop.end_moisture_pct
    if effects.moisture_dependence is None or end == crop.moisture_pct:
        grain = crop.grain.at_moisture(crop.moisture_pct, effects.moisture_dependence)
        return _table(machine, (Condition(crop.moisture_pct, grain, effects),), _FINE if scenario.kernels else None)
    nodes = np.linspace(min(end, crop.moisture_pct), max(end, crop.moisture_pct), _MOISTURE_NODES)
    conditions = (Condition(float(m), crop.grain.at_moisture(float(m), effects.moisture_dependence), effects) for m in nodes)
    return _table(machine, tuple(conditions), _FINE if scenario.kernels else _CHANGING)


@lru_cache(maxsize=4)
def _table(machine: Machine, conditions: tuple[Condition, ...], detail: Detail | None) -> PulseTable:
    """A table takes a second to build and holds about 3 MB; the latest are kept."""
    return PulseTable(machine, conditions, detail)


class VirtualCombine:
    """A combine on a bus, simulated.

    Parameters
    ----------
    scenario : Scenario
    machine : Machine, optional
        None: the shipped one.
    seed : int
        The same scenario, machine, seed and commands give the same frames.
    table : PulseTable, optional
        Pulses of this crop and machine, where they are at hand.

    Attributes
    ----------
    scenario : Scenario
    machine : Machine

    Raises
    ------
    InputError
        For an argument of another type.

    Notes
    -----
    Bus time starts at 0 and ends at the scenario's duration. `frames_until` and `samples_until` advance it (use one of them);
    `handle` takes PlateActuatorCommand frames; `truth` is the true state so far.

    Examples
    --------
    >>> combine = api.VirtualCombine(api.Scenario(duration_s=10), seed=1)
    >>> sum(frame.message == "ImpactSensorSamples" for frame in combine.frames_until(2.0))
    500
    """

    def __init__(
        self, scenario: Scenario, machine: Machine | None = None, seed: int = 0, table: PulseTable | None = None
    ) -> None:
        require_type("scenario", scenario, Scenario, "a Scenario, as `load_scenario` gives it")
        require_type("machine", machine, (Machine, NoneType), "a Machine, or None")
        self.scenario = scenario
        self.machine = machine or Machine()
        seeds = np.random.SeedSequence(seed).spawn(8)
        flow_rng, speed_rng, scatter_rng, self._noise_rng, zero_rng, actuator_rng, nodes_rng, self._kernel_rng = (
            np.random.default_rng(s) for s in seeds
        )
        self._table = table or pulse_table(scenario, self.machine)
        effects = scenario.effects
        slip = effects.chain_slip.share if effects.chain_slip else 0.0
        self._harvest = profiles.harvest(scenario.flow, scenario.duration_s + 1.0, flow_rng)
        self._run = elevator.run(scenario.elevator, self.machine, self._harvest, slip, speed_rng)
        lag = self._mean_lag_s()
        self._paddles = elevator.paddles(
            self._run,
            self._harvest,
            self.machine,
            slip_share=slip,
            lag_s=lag,
            first_gap=float(flow_rng.random()),
            full_paddle_kg=self._table.largest_mass_kg,
        )
        self._delivered = np.cumsum(self._paddles.mass_kg)
        scatter = scenario.paddle_scatter_pct / 100.0 * scatter_rng.standard_normal(len(self._paddles.mass_kg))
        self._scatter = np.maximum(1.0 + scatter, 0.0)
        self._speed_low, self._speed_high = self._table.speed_range_rad_s
        self._steps = _KERNEL_STEPS if scenario.kernels else 1
        share = effects.cell_nonlinearity.share if effects.cell_nonlinearity else 0.0
        self._cell = ImpactCell(scenario.sensor, self.machine.sensor, share, self._steps)
        self._actuator = PlateActuator(scenario.actuator, self.machine, actuator_rng)
        self._angle_offset = effects.plate_angle_offset.angle_deg if effects.plate_angle_offset else 0.0
        self._tank = Tank(scenario.tank)
        self._course = CropCourse(scenario)
        self._nodes = Nodes(
            scenario,
            run=self._run,
            harvest=self._harvest,
            cell=self._cell,
            actuator=self._actuator,
            tank=self._tank,
            rng=nodes_rng,
        )
        self._zero_walk = np.cumsum(
            scenario.sensor.drift_mv_per_sqrt_h / 60.0 * zero_rng.standard_normal(int(scenario.duration_s) + 2)
        )
        self._commands: list[Frame] = []
        self._block = 0
        self._blocks = floor(scenario.duration_s / BLOCK_S + 1e-9)
        self._next_paddle = 0
        self._ahead = np.zeros((BLOCK_SAMPLES + _PULSE_ROOM) * self._steps)
        self._background = np.zeros(0)
        self._rows: list[tuple[float, ...]] = []
        self._second: list[tuple[Array, Array]] = []
        self._impulses: list[tuple[float, float]] = []

    def _mean_lag_s(self) -> float:
        """Time from a paddle's pointing up to the middle of its pulse in the samples, at nominal speed and home angle."""
        speed = self.scenario.elevator.speed_rpm * RPM
        mass = 10.0 * self.machine.paddle_spacing_m / self.machine.paddle_speed_m_s(speed)
        home = self.machine.home_plate_angle_rad
        times = self._table.arrival_times_s(mass, home, speed, self.scenario.crop.moisture_pct)
        return float(scipy.integrate.trapezoid(times, QUANTILES)) + 2.0 * self.scenario.sensor.response_s

    @property
    def time_s(self) -> float:
        """Bus time reached."""
        return self._block * BLOCK_S

    def handle(self, frame: Frame) -> None:
        """Take a frame from the bus.

        Parameters
        ----------
        frame : Frame
            Other messages than PlateActuatorCommand are passed over.
        """
        if frame.message == frames.PLATE_ACTUATOR_COMMAND:
            self._commands.append(frame)

    def frames_until(self, time_s: float) -> Iterator[Frame]:
        """Frames in order of time. Commands taken meanwhile act from the next block (20 ms) on.

        Parameters
        ----------
        time_s : float
            Bus time, s; at most the scenario's duration.

        Yields
        ------
        Frame
        """
        while self._block < self._blocks and self.time_s + BLOCK_S <= time_s + 1e-9:
            start = self._block
            voltage, _, _ = self._advance()
            yield from self._nodes.frames_of(start, voltage)

    def samples_until(self, time_s: float) -> Samples:
        """The same samples as arrays, without making frames.

        Parameters
        ----------
        time_s : float
            Bus time, s; at most the scenario's duration.

        Returns
        -------
        Samples
            time_s (s), sample_mv (mV), plate_angle_deg (deg), speed_rad_s (rad/s), each (n,).
        """
        blocks = []
        first = self._block
        while self._block < self._blocks and self.time_s + BLOCK_S <= time_s + 1e-9:
            blocks.append(self._advance())
        voltage, angle, speed = (np.concatenate([b[i] for b in blocks]) if blocks else np.zeros(0) for i in range(3))
        time = (first * BLOCK_SAMPLES + np.arange(1.0, len(voltage) + 1.0)) * frames.SAMPLE_INTERVAL_S
        return Samples(time, voltage, angle, speed)

    @property
    def truth(self) -> Truth:
        """The true flow and masses up to the last full second."""
        table = np.array(self._rows).reshape(-1, len(TRUTH_COLUMNS))
        done = len(self._impulses)
        impulses = np.array(self._impulses).reshape(-1, 2)
        return Truth(
            columns={name: table[:, i] for i, name in enumerate(TRUTH_COLUMNS)},
            loads=tuple(self._tank.loads),
            paddles={
                "time_s": self._paddles.time_s[:done],
                "mass_kg": self._paddles.mass_kg[:done],
                "impulse_n_s": impulses[:, 0],
                "plate_angle_deg": impulses[:, 1],
            },
        )

    def _advance(self) -> tuple[Array, Array, Array]:
        """One block: voltage, true plate angle (deg) and sprocket speed of its samples."""
        start_s = self.time_s
        end_s = (self._block + 1) * BLOCK_S
        self._actuator.fault = self._actuator_fault(start_s)
        for command in self._commands:
            self._actuator.command(command, start_s)
        self._commands.clear()
        angle_deg = self._actuator.step(end_s, BLOCK_S) + self._angle_offset
        self._drop_paddles(end_s, angle_deg)

        block = BLOCK_SAMPLES * self._steps
        force = self._ahead[:block].copy()
        self._ahead[:-block] = self._ahead[block:]
        self._ahead[-block:] = 0.0
        if len(self._background) == 0:
            self._background, self._speeds = self._next_chunk()
        background, self._background = np.split(self._background, [BLOCK_SAMPLES])
        speeds, self._speeds = np.split(self._speeds, [BLOCK_SAMPLES])
        still = self._still_force_n(start_s, angle_deg) / self.machine.sensor.gain_n_per_mv
        voltage = self._cell.samples_mv(force, background + still, sensor_fault(self.scenario, start_s))
        self._second.append((force, np.array([angle_deg, float(speeds[-1])])))
        self._block += 1
        if self._block % round(1.0 / BLOCK_S) == 0:
            self._close_second()
        return voltage, np.full(BLOCK_SAMPLES, angle_deg), speeds

    def _drop_paddles(self, end_s: float, angle_deg: float) -> None:
        """Add the pulses of the paddles that point up in this block to the force ahead."""
        start_s = self._block * BLOCK_S
        while self._next_paddle < len(self._paddles.time_s) and self._paddles.time_s[self._next_paddle] < end_s:
            i = self._next_paddle
            self._next_paddle += 1
            mass, time = float(self._paddles.mass_kg[i]), float(self._paddles.time_s[i])
            impulse = 0.0
            if mass > 0.0:
                impulse, arrivals = self._pulse(mass, np.deg2rad(angle_deg), float(self._paddles.speed_rad_s[i]), time)
                impulse *= float(self._scatter[i])
                step_s = frames.SAMPLE_INTERVAL_S / self._steps
                if self.scenario.kernels is None:
                    edges = start_s + np.arange(len(self._ahead) + 1) * step_s
                    arrived = np.interp(edges, time + arrivals, QUANTILES, left=0.0, right=1.0)
                    self._ahead += impulse / step_s * np.diff(arrived)
                else:
                    grain, begin = self.scenario.kernels, time - start_s
                    struck = kernels.strike(grain, mass, impulse, begin + arrivals, step_s, len(self._ahead), self._kernel_rng)
                    self._ahead += struck / step_s
                    impulse = float(struck.sum())
            self._impulses.append((impulse, angle_deg))

    def _pulse(self, mass_kg: float, angle_rad: float, speed_rad_s: float, time_s: float) -> tuple[float, Array]:
        """Impulse and arrival times. Below the table's speeds what lands shrinks with the square of the speed."""
        covered = min(max(speed_rad_s, self._speed_low), self._speed_high)
        arguments = (mass_kg, angle_rad, covered, self._course.moisture_pct(time_s))
        impulse = float(self._table.impulse_n_s(*arguments)) * (speed_rad_s / covered) ** 2
        return impulse, self._table.arrival_times_s(*arguments)

    def _still_force_n(self, time_s: float, angle_deg: float) -> float:
        """Force that does not come in pulses: what sticks to the plate, and an offset that comes with the grain."""
        effects, force = self.scenario.effects, 0.0
        if effects.plate_buildup is not None:
            angle = np.deg2rad(angle_deg)
            force += effects.plate_buildup.mass_kg * GRAVITY_M_S2 * float(np.cos(angle) * np.sin(angle))
        if effects.zero_offset is not None and profiles.at(self._harvest.flow_kg_s, time_s) > 0.0:
            force += effects.zero_offset.force_n
        return force

    def _next_chunk(self) -> tuple[Array, Array]:
        """Zero voltage with noise and vibration (mV), and sprocket speed, for the next second of samples."""
        settings = self.scenario.sensor
        time = (self._block * BLOCK_SAMPLES + 1 + np.arange(_CHUNK_SAMPLES)) * frames.SAMPLE_INTERVAL_S
        grid = time / profiles.SAMPLE_INTERVAL_S
        index = np.minimum(grid.astype(int), len(self._run.speed_rad_s) - 2)
        share = grid - index
        speed = self._run.speed_rad_s[index] * (1.0 - share) + self._run.speed_rad_s[index + 1] * share
        chain = self._run.chain_m[index] * (1.0 - share) + self._run.chain_m[index + 1] * share
        vibration = sensor.vibration_n(
            settings,
            chain / (2.0 * np.pi * self.machine.sprocket_pitch_radius_m),
            chain / self.machine.pattern_length_m,
            speed / (400.0 * RPM),
            len(self.machine.paddle_spacings_m),
        )
        noise = settings.noise_mv * self._noise_rng.standard_normal(_CHUNK_SAMPLES)
        zero = np.interp(time, np.arange(len(self._zero_walk)), self._zero_walk) + self._course.zero_mv(float(time[0]))
        return zero + noise + vibration / self.machine.sensor.gain_n_per_mv, speed

    def _close_second(self) -> None:
        end_s = self.time_s
        force = np.concatenate([f for f, _ in self._second])
        state = np.array([s for _, s in self._second])
        self._second.clear()
        total, before = (float(self.delivered_kg(t)) for t in (end_s, end_s - 1.0))
        working = bool(profiles.at(self._harvest.working, end_s - 0.5))
        self._tank.step(end_s, total - before, working)
        zero = self._course.zero_mv(end_s) + float(np.interp(end_s, np.arange(len(self._zero_walk)), self._zero_walk))
        self._rows.append(
            (
                end_s,
                total - before,
                total,
                self._tank.mass_kg,
                float(state[:, 0].mean()),
                float(state[:, 1].mean()) / RPM,
                float(force.mean()),
                zero,
                self._course.moisture_pct(end_s),
                float(working),
                float(len(self._tank.loads)),
            )
        )

    def delivered_kg(self, time_s: ArrayLike) -> Array:
        """True mass past the plate, interpolated linearly between paddle passes.

        Parameters
        ----------
        time_s : array_like
            Bus time, s.

        Returns
        -------
        ndarray
            kg, of the shape of time_s.
        """
        paddles = self._paddles
        if len(paddles.mass_kg) == 0:
            return np.zeros(np.shape(time_s))
        return np.asarray(np.interp(np.asarray(time_s), paddles.delivered_until_s, self._delivered, left=0.0))

    def _actuator_fault(self, time_s: float) -> ActuatorFault | None:
        return next((f.kind for f in self.scenario.faults.actuator if f.active(time_s)), None)
