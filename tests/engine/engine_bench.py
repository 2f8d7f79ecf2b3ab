"""A pulse train and its frames, simple enough to know the answer: for the engine's tests only.

Force per paddle is proportional to its mass, so with `ForceProportional` the flow is known exactly whatever the physics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yieldmon import frames as bus
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.health import FaultEvent
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import Result, events_in, frames_in, records_in
from yieldmon.engine.runs import FrameRun, SampleRun, SignalRun
from yieldmon.engine.self_calibration.calibrator_state import CalibratorState
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.open_loop import FlowEstimate, FlowStatus
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.frames import Frame
from yieldmon.physics.machine import RPM, Machine

MACHINE = Machine()
HOME_DEG = 70.0
ZERO_MV = 150.0
N_PER_KG_S = 4.0
FULL_FLOW_KG_S = 30.0

PARAMETERS = ParameterSet(values={"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.6})


class NothingBetweenUpdates:
    """Of a `SelfCalibrator` for tests: between its updates nothing drifts, and it keeps nothing over a restart."""

    def drift_std_dev(self, record: WindowRecord, estimator: FlowEstimator) -> float:
        return 0.0

    def follow(self, record: WindowRecord, estimator: FlowEstimator) -> None:
        return None

    def snapshot(self, now_s: float, total_kg: float) -> None:
        return None

    def restore(self, state: CalibratorState, parameters: ParameterSet, total_kg: float) -> None:
        raise AssertionError("nothing was kept")


@dataclass
class ForceProportional:
    """mass flow = force / N_PER_KG_S at home, growing by 1 % of it per degree towards 90; above 30 kg/s it is saturated."""

    parameters: ParameterSet = PARAMETERS
    relative_std_dev: float = 0.01
    calls: int = 0

    def estimate(
        self,
        force_n: ArrayLike,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        force_std_dev_n: ArrayLike = 0.0,
        moisture_pct: ArrayLike | None = None,
    ) -> FlowEstimate:
        self.calls += 1
        force, noise = np.asarray(force_n, dtype=float), np.asarray(force_std_dev_n, dtype=float)
        gain = N_PER_KG_S * angle_factor(np.degrees(np.asarray(plate_angle_rad, dtype=float)))
        flow = np.maximum(force / gain, 0.0)
        std_dev = np.hypot(noise / gain, self.relative_std_dev * flow)
        status = np.where(flow <= 0.0, FlowStatus.NO_GRAIN, FlowStatus.OK)
        status = np.where(flow > FULL_FLOW_KG_S, FlowStatus.SATURATED, status)
        status = np.where(np.isfinite(flow + std_dev), status, FlowStatus.NOT_AVAILABLE)
        known = (status != FlowStatus.SATURATED) & (status != FlowStatus.NOT_AVAILABLE)
        return FlowEstimate(np.where(known, flow, np.nan), np.where(known, std_dev, np.nan), status)

    def force_curve(self, plate_angle_rad: float, elevator_speed_rad_s: float, moisture_pct: float = 0.0) -> tuple[Any, Any]:
        flow = np.linspace(0.0, FULL_FLOW_KG_S, 31)
        return N_PER_KG_S * angle_factor(np.degrees(plate_angle_rad)) * flow, flow


def angle_factor(angle_deg: Any) -> Any:
    """Force at an angle over force at home."""
    return 1.0 + 0.01 * (angle_deg - HOME_DEG)


@dataclass
class Bench:
    """Frames of an elevator with known flow. flow, rpm, angle are functions of time (s); pulses are Gaussian.

    Times start at start_s. Noise and scatter come from the seed. `drop` says which sample frames never arrive (by their index).
    """

    flow: Callable[[float], float] = lambda time_s: 0.0
    rpm: Callable[[float], float] = lambda time_s: 400.0
    angle: Callable[[float], float] = lambda time_s: HOME_DEG
    zero: Callable[[float], float] = lambda time_s: ZERO_MV
    start_s: float = 1000.0
    noise_mv: float = 0.5
    scatter: float = 0.0
    shaft_vibration_mv: float = 0.0
    paddle_vibration_mv: float = 0.0
    pulse_std_dev_s: float = 0.012
    seed: int = 1
    drop: Callable[[int], bool] = lambda index: False
    machine: Machine = field(default_factory=Machine)

    def force_mv(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sensor voltage above zero: one pulse a paddle, its momentum that of the flow when it passes."""
        machine, gain = self.machine, N_PER_KG_S / self.machine.sensor.gain_n_per_mv
        generator = np.random.default_rng(self.seed)
        grid = np.arange(times_s[0] - 0.5, times_s[-1] + 0.5, 0.001)
        chain = np.cumsum(machine.paddle_speed_m_s(np.array([self.rpm(t) for t in grid.tolist()]) * RPM)) * 0.001
        voltage = np.zeros_like(times_s)
        marks = []
        position = 0.0
        index = 0
        spacings = machine.paddle_spacings_m
        while position < chain[-1]:
            marks.append((position, spacings[index % len(spacings)]))
            position += spacings[index % len(spacings)]
            index += 1
        for place, spacing in marks:
            at = float(np.interp(place, chain, grid))
            mass = max(0.0, self.flow(at)) * spacing / machine.paddle_speed_m_s(self.rpm(at) * RPM)
            mass *= 1.0 + self.scatter * generator.standard_normal()
            low, high = np.searchsorted(times_s, (at - 6 * self.pulse_std_dev_s, at + 6 * self.pulse_std_dev_s))
            shape = np.exp(-0.5 * ((times_s[low:high] - at) / self.pulse_std_dev_s) ** 2)
            height = mass * gain * angle_factor(self.angle(at)) / (self.pulse_std_dev_s * (2 * np.pi) ** 0.5)
            voltage[low:high] += height * shape
        shaft = np.interp(times_s, grid, chain / machine.sprocket_pitch_radius_m)
        passes = np.interp(times_s, grid, chain / machine.pattern_length_m) * len(spacings)
        vibration = self.paddle_vibration_mv * np.sin(2 * np.pi * passes + 0.7)
        return voltage + self.shaft_vibration_mv * np.sin(shaft) + vibration

    def sample_frames(self, seconds: float) -> dict[str, NDArray[np.float64]]:
        """Sample frames as arrays: times (n,), millivolts (n, 4), counters, statuses."""
        count = round(seconds * 250)
        times = self.start_s + 0.004 * np.arange(1, count + 1)
        sample_times = self.start_s + 0.001 * np.arange(1, 4 * count + 1)
        generator = np.random.default_rng(self.seed + 1)
        zero = np.array([self.zero(t) for t in times.tolist()]).repeat(4)
        values = self.force_mv(sample_times) + zero + self.noise_mv * generator.standard_normal(4 * count)
        quantised = np.round(values * 2.0) / 2.0
        keep = np.array([not self.drop(i) for i in range(count)])
        return {
            "times_s": times[keep],
            "millivolts": quantised.reshape(-1, 4)[keep],
            "counters": (np.arange(count) % 256).astype(float)[keep],
            "statuses": np.zeros(count)[keep],
        }

    def frames(self, seconds: float) -> list[Frame]:
        """All input frames in order of time."""
        samples = self.sample_frames(seconds)
        out = [
            sample_frame(t, mv, c)
            for t, mv, c in zip(*(samples[name].tolist() for name in ("times_s", "millivolts", "counters")), strict=True)
        ]
        out += list(self.slow_frames(seconds))
        return sorted(out, key=lambda frame: frame.time_s)

    def run(self, seconds: float) -> FrameRun:
        """The same input as columns, in a fifth of the time; the engine makes the same of it (test_engine_runs)."""
        samples = self.sample_frames(seconds)
        slow = sorted(self.slow_frames(seconds), key=lambda frame: frame.time_s)
        times = np.concatenate((samples["times_s"], [frame.time_s for frame in slow]))
        order = np.argsort(times, kind="stable")
        places = np.empty(len(order), dtype=np.intp)
        places[order] = np.arange(len(order))
        first_slow = len(samples["times_s"])
        rows = np.column_stack((samples["counters"], samples["statuses"], samples["millivolts"]))
        others = []
        for message in (bus.ELEVATOR_SPEED, bus.PLATE_ACTUATOR_FEEDBACK):
            at = [k for k, frame in enumerate(slow) if frame.message == message]
            names = slow[at[0]].signals
            columns = {name: np.array([float(slow[k].signals[name]) for k in at]) for name in names}
            others.append(SignalRun(message, places[first_slow + np.array(at)], np.array([slow[k].time_s for k in at]), columns))
        return FrameRun(times[order], [SampleRun(places[:first_slow], rows)], others)

    def slow_frames(self, seconds: float) -> Iterator[Frame]:
        """Speed at 10 Hz and plate feedback at 20 Hz."""
        for i in range(round(seconds * 10)):
            t = self.start_s + 0.0011 + 0.1 * i
            yield Frame(t, bus.ELEVATOR_SPEED, {"ElevatorSpeed": round(self.rpm(t) / 0.125) * 0.125})
        for i in range(round(seconds * 20)):
            t = self.start_s + 0.0021 + 0.05 * i
            yield Frame(t, bus.PLATE_ACTUATOR_FEEDBACK, {"PlateAngle": self.angle(t), "ActuatorState": 0})


@dataclass
class Actuator:
    """A plate actuator with a rate limit, and the ways in which it can fail.

    fault: "" none; "stuck" does not move; "frozen" moves and reports the angle at which it was; "silent" sends no feedback;
    "lying" stays and reports the target; "manual" is held by hand and says so; "broken" reports a fault. Each from fault_from_s
    to fault_to_s.
    """

    rate_deg_s: float = 25.0
    fault: str = ""
    fault_from_s: float = 0.0
    fault_to_s: float = float("inf")
    angle_deg: float = HOME_DEG
    target_deg: float | None = None
    reported_deg: float = HOME_DEG
    modes: list[int] = field(default_factory=list)
    targets: list[float] = field(default_factory=list)

    def handle(self, frame: Frame) -> None:
        """Take a command."""
        mode, target = frame.signals["CommandMode"], frame.signals["TargetPlateAngle"]
        self.modes.append(int(mode))
        if mode == bus.CommandMode.RELEASE:
            self.target_deg = None
        else:
            assert isinstance(target, float)
            self.targets.append(target)
            self.target_deg = target

    def faulty(self, time_s: float, kind: str) -> bool:
        """Whether one kind of fault is on."""
        return self.fault == kind and self.fault_from_s <= time_s < self.fault_to_s

    def step(self, time_s: float, seconds: float) -> None:
        """Move towards the target."""
        held = any(self.faulty(time_s, kind) for kind in ("stuck", "lying", "manual", "broken"))
        if self.target_deg is not None and not held:
            reach = self.rate_deg_s * seconds
            self.angle_deg += min(reach, max(-reach, self.target_deg - self.angle_deg))

    def feedback(self, time_s: float) -> Frame | None:
        """What it reports, None when silent."""
        if self.faulty(time_s, "silent"):
            return None
        moving = self.target_deg is not None and abs(self.target_deg - self.angle_deg) > 0.01
        state = bus.ActuatorState.MOVING if moving else bus.ActuatorState.IDLE
        angle = self.angle_deg
        if self.faulty(time_s, "lying") and self.target_deg is not None:
            angle, state = self.target_deg, bus.ActuatorState.IDLE
        if self.faulty(time_s, "manual"):
            state = bus.ActuatorState.MANUAL
        if self.faulty(time_s, "broken"):
            state = bus.ActuatorState.FAULT
        self.reported_deg = angle = self.reported_deg if self.faulty(time_s, "frozen") else angle
        return Frame(time_s, bus.PLATE_ACTUATOR_FEEDBACK, {"PlateAngle": angle, "ActuatorState": int(state)})


def run_with_actuator(
    target: Monitor,
    bench: Bench,
    actuator: Actuator,
    seconds: float,
    at: Mapping[float, Callable[[Monitor], object]] | None = None,
) -> list[Frame]:
    """The bench with the plate in the loop. at: operator's actions by time since the start, s. Returns all output."""
    samples = bench.sample_frames(seconds)
    actions = sorted((at or {}).items())
    out: list[Frame] = []
    for index, (time_s, values) in enumerate(zip(samples["times_s"].tolist(), samples["millivolts"], strict=True)):
        while actions and time_s >= bench.start_s + actions[0][0]:
            actions.pop(0)[1](target)
        actuator.step(time_s, 0.004)
        shaped = bench.zero(time_s) + (values - bench.zero(time_s)) * angle_factor(actuator.angle_deg)
        frames = [sample_frame(time_s, shaped.tolist(), samples["counters"][index])]
        if index % 25 == 0:
            frames.append(Frame(time_s, bus.ELEVATOR_SPEED, {"ElevatorSpeed": bench.rpm(time_s)}))
        if index % 12 == 0:
            feedback = actuator.feedback(time_s)
            frames += [feedback] if feedback else []
        for frame in frames:
            for sent in frames_in(target.feed(frame)):
                out.append(sent)
                if sent.message == bus.PLATE_ACTUATOR_COMMAND:
                    actuator.handle(sent)
    return out


def sample_frame(time_s: float, millivolts: list[float], counter: float, status: int = 0) -> Frame:
    """One ImpactSensorSamples frame."""
    signals: dict[str, bus.Value] = {f"Sample{i}": value for i, value in enumerate(millivolts)}
    signals["SampleCounter"] = int(counter)
    signals["SensorStatus"] = status
    return Frame(time_s, bus.IMPACT_SENSOR_SAMPLES, signals)


class Kept(Monitor):
    """A monitor that keeps all that it has handed back."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.results: list[Result] = []

    def feed(self, frame: Frame) -> list[Result]:
        return self._kept(super().feed(frame))

    def tick(self, time_s: float) -> list[Result]:
        return self._kept(super().tick(time_s))

    def feed_run(self, run: FrameRun, *, reports: bool = True) -> list[Result]:
        before = len(self.results)
        found = super().feed_run(run, reports=reports)
        del self.results[before:]  # what came frame by frame is in there
        return self._kept(found)

    @property
    def records(self) -> list[WindowRecord]:
        """Of all windows."""
        return records_in(self.results)

    @property
    def fault_events(self) -> list[FaultEvent]:
        """Faults shown and withdrawn."""
        return [event for event in events_in(self.results) if isinstance(event, FaultEvent)]

    def _kept(self, found: list[Result]) -> list[Result]:
        self.results += found
        return found


def monitor(settings: EngineSettings | None = None, **options: Any) -> Kept:
    """A monitor with the proportional estimator."""
    return Kept(settings or EngineSettings(), MACHINE, options.pop("estimator", ForceProportional()), **options)


def feed(target: Monitor, frames: list[Frame] | FrameRun) -> list[Frame]:
    """Feed frames one by one, or a run of them at once; returns all output."""
    return frames_in(target.feed_run(frames) if isinstance(frames, FrameRun) else results(target, frames))


def results(target: Monitor, frames: list[Frame]) -> list[Result]:
    """Feed frames one by one; returns all that happened."""
    return [result for frame in frames for result in target.feed(frame)]


def only(frames: list[Frame], message: str) -> list[Frame]:
    """Frames of one message."""
    return [frame for frame in frames if frame.message == message]


def flows(frames: list[Frame]) -> list[float]:
    """MassFlowRate of each window, nan where it is not available."""
    rates = (frame.signals["MassFlowRate"] for frame in only(frames, bus.MASS_FLOW))
    return [float(rate) if isinstance(rate, (int, float)) else float("nan") for rate in rates]


def qualities(frames: list[Frame]) -> list[bus.EstimateQuality]:
    """EstimateQuality of each window."""
    return [bus.EstimateQuality(frame.signals["EstimateQuality"]) for frame in only(frames, bus.MASS_FLOW)]
