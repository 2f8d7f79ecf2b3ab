"""The yield monitor: frames in, frames out, time only from the frames.

`feed` and `feed_run` give the same bits for the same frames, one by one or in blocks. Nothing here raises on any sequence of
frames: what cannot be used is left out, and quality and faults say so. The published flow weighs each window with those before it
(`flow_filter`); totals and sweeps take each window as it was measured.

One window ends each second, `WindowSettings.grid_offset_s` after the full second of bus time.

Rules for the totals. A window that is partly lost counts its whole duration at the mean of what was measured in it, as long as
that is at least `WindowSettings.min_coverage` of it; below that, only the time that was measured counts. A window without flow
(not harvesting, no zero yet, an input missing) adds nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import degrees, floor, hypot, isfinite, radians

import numpy as np
from numpy.typing import NDArray

from yieldmon import frames as bus
from yieldmon.engine.anchors import AnchorSource, ReferenceMass, TankScale
from yieldmon.engine.clock import BusClock
from yieldmon.engine.faults import FAULTS, FaultBook, FaultCode, Severity
from yieldmon.engine.flow_filter import FlowFilter
from yieldmon.engine.gates import GateInputs, HarvestGate
from yieldmon.engine.plate_commands import RELEASE, PlateCommander
from yieldmon.engine.records import CalibrationOutcome, FlowEstimator, SelfCalibrator, WindowRecord
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.state import EngineState
from yieldmon.engine.sweep import PlateReading, SweepAbort, SweepMachine, SweepWindow
from yieldmon.engine.totals import Totals, dry_mass
from yieldmon.engine.windows import Window, WindowBuilder, number
from yieldmon.engine.zero import ZeroTracker
from yieldmon.estimation.open_loop import FlowStatus
from yieldmon.frames import (
    NOT_AVAILABLE,
    ActuatorState,
    CommandMode,
    EstimateQuality,
    Frame,
    OperatingState,
    ScaleStatus,
    Value,
)
from yieldmon.physics.machine import RPM, Machine

_NAN = float("nan")
_KEPT_RECORDS = 7200
_KEPT_LOADS = 256
_MAX_PLAUSIBLE_RPM = 3000.0
_MAX_PLAUSIBLE_ANGLE_DEG = 180.0
_KMH = 1.0 / 3.6
_COUNTER_MODULUS = 256
_NO_FAULTS: dict[str, Value] = {code.value: 0 for code in FAULTS}


class Held:
    """Last usable value of an input and the engine time it came at."""

    __slots__ = ("time_s", "value")

    def __init__(self) -> None:
        self.value = _NAN
        self.time_s = float("-inf")

    def set(self, time_s: float, value: float) -> None:
        """A new value."""
        self.value = value
        self.time_s = time_s

    def within(self, now_s: float, timeout_s: float) -> float:
        """The value while it is fresh, else nan."""
        return self.value if now_s - self.time_s <= timeout_s else _NAN


@dataclass(frozen=True, slots=True)
class LoadSummary:
    """One load: bus times of its start and end (nan while open), masses in kg. complete: every second of it was measured."""

    number: int
    start_s: float
    end_s: float
    measured_kg: float
    dry_kg: float
    unknown_moisture_kg: float
    complete: bool


@dataclass(frozen=True, slots=True)
class SampleRun:
    """Consecutive ImpactSensorSamples frames as arrays: times_s (bus time), counters and statuses (n,), millivolts (n, samples).

    nan for what is not available. places (m,): how many of these frames came before each of the m frames of other messages that
    are fed along with them; not falling.
    """

    times_s: NDArray[np.float64]
    millivolts: NDArray[np.float64]
    counters: NDArray[np.float64]
    statuses: NDArray[np.float64]
    places: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, dtype=np.intp))


@dataclass(frozen=True, slots=True)
class _Flow:
    """Flow of a window, nan where there is none, what it is worth, and whether grain was seen."""

    rate_kg_s: float
    std_dev_kg_s: float
    quality: EstimateQuality
    force_n: float
    force_std_dev_n: float
    out_of_calibration: bool = False
    saturated: bool = False
    noise_kg_s: float = _NAN
    """The part of std_dev_kg_s that changes from window to window."""


class Monitor:
    """One yield monitor on one bus.

    estimator turns force into flow; calibrator, if any, learns from sweeps. Operator commands are plain methods; they take effect
    with the next window or tick.
    """

    def __init__(
        self,
        settings: EngineSettings,
        machine: Machine,
        estimator: FlowEstimator,
        calibrator: SelfCalibrator | None = None,
    ) -> None:
        self.settings = settings
        self.machine = machine
        self.faults = FaultBook()
        self.totals = Totals()
        self._estimator = estimator
        self._calibrator = calibrator
        self._clock = BusClock(settings.clock)
        self._builder = WindowBuilder(settings.windows, machine)
        self._zero = ZeroTracker(settings.zero)
        self._gate = HarvestGate(settings.gate)
        self._filter = FlowFilter(settings.flow_filter)
        self._commander = PlateCommander(settings.plate, machine)
        self._sweep = SweepMachine(settings.sweep, settings.plate, degrees(machine.home_plate_angle_rad))
        self._scale = TankScale(settings.anchors)
        self._tickets: deque[ReferenceMass] = deque(maxlen=settings.anchors.keep)
        self._ticks_per_window = round(settings.windows.window_s / settings.plate.command_interval_s)
        self._offset_ticks = round(settings.windows.grid_offset_s / settings.plate.command_interval_s)
        self._begun = False
        self._tick = self._next_tick = 0
        self._next_s = float("-inf")
        self._window_start_s = 0.0
        self._speed = Held()
        self._angle = Held()
        self._moisture = Held()
        self._test_weight = Held()
        self._latitude = Held()
        self._longitude = Held()
        self._course = Held()
        self._ground_speed = Held()
        self._header_down = Held()
        self._working = Held()
        self._scale_status = Held()
        self._actuator = ActuatorState.IDLE
        self._idle_since_s: float | None = None
        self._cutting_s = float("-inf")
        self._windows = 0
        self._stuck = 0
        self._jumps_seen = 0
        self._jump_shown = 0
        self._driving = False
        self._calibration_age_s: float | None = None
        self._outcome: CalibrationOutcome | None = None
        self._sweep_records: list[WindowRecord] = []
        self._records: deque[WindowRecord] = deque(maxlen=_KEPT_RECORDS)
        self._loads: deque[LoadSummary] = deque(maxlen=_KEPT_LOADS)
        self._load_start_s = _NAN
        self._load_complete = True
        self._last_record: WindowRecord | None = None
        self._diagnostic = 0
        self._handlers: dict[str, Callable[[float, Mapping[str, Value]], None]] = {
            bus.IMPACT_SENSOR_SAMPLES: self._on_samples,
            bus.ELEVATOR_SPEED: self._on_speed,
            bus.PLATE_ACTUATOR_FEEDBACK: self._on_feedback,
            bus.GRAIN_CONDITION: self._on_grain,
            bus.TANK_SCALE: self._on_scale,
            bus.HARVEST_STATE: self._on_harvest_state,
            bus.VEHICLE_POSITION: self._on_position,
            bus.VEHICLE_DIRECTION_SPEED: self._on_direction,
        }

    # Frames

    def feed(self, frame: Frame) -> list[Frame]:
        """Take one frame; returns what is to be sent, in order, usually nothing."""
        now = self._clock.engine_time(frame.time_s)
        if now is None:
            return []
        out = self._advance(now) if now >= self._next_s else []
        handler = self._handlers.get(frame.message)
        if handler is not None:
            handler(now, frame.signals)
        return out

    def tick(self, time_s: float) -> list[Frame]:
        """Bus time has come to time_s (s) without a frame of ours; returns what is to be sent."""
        now = self._clock.engine_time(time_s)
        return [] if now is None else self._advance(now)

    def feed_run(self, run: SampleRun, others: Sequence[Frame] = ()) -> list[Frame]:
        """Take a run of ImpactSensorSamples frames and the frames of other messages that came among them.

        The same as `feed` frame by frame in order of arrival, to the bit, at a fraction of its cost.
        """
        count = run.times_s.size
        places = run.places + np.arange(len(others), dtype=np.intp)
        rows = np.column_stack((run.times_s, run.counters, run.statuses, run.millivolts)).astype(np.float64, copy=False)
        times = np.insert(run.times_s, run.places, [frame.time_s for frame in others])
        if self._clock.now_s is None and times.size:
            start = self._clock.engine_time(float(times[0]))
            if start is not None:
                self._advance(start)
        if not self._clock.regular(times):
            return self._feed_merged(rows, others, run.places)
        times = times + self._clock.offset_s
        rows[:, 0] += self._clock.offset_s
        out: list[Frame] = []
        done, other = 0, 0
        while done < times.size:
            after = done + int(np.searchsorted(times[done:], self._next_s, side="left"))
            next_other = int(np.searchsorted(places, after, side="left"))
            first, last = done - other, after - next_other
            if last > first:
                self._builder.add_block(rows[first:last])
            for index in range(other, next_other):
                frame = others[index]
                handler = self._handlers.get(frame.message)
                if handler is not None:
                    handler(float(times[places[index]]), frame.signals)
            if after < times.size:
                out += self._advance(float(times[after]))
            done, other = after, next_other
        if count or others:
            self._clock.now_s = float(times[-1])
        return out

    # Operator and service

    def start_load(self) -> int:
        """Begin a new load; returns its number."""
        self._close_load()
        self.totals = self.totals.start_load()
        self._load_start_s = self._bus_now()
        self._load_complete = True
        return self.totals.load_number

    def stop_load(self) -> None:
        """The load is complete; mass measured from now on belongs to no load until the next one starts."""
        self._close_load()
        self.totals = self.totals.stop_load()

    def calibrate_zero(self) -> None:
        """Zero-flow calibration: the operator vouches that the elevator runs empty for the next seconds."""
        self._zero.calibrate()

    def request_sweep(self) -> None:
        """Sweep as soon as the conditions hold."""
        self._sweep.request()

    def abort_sweep(self) -> None:
        """End a sweep and take the plate home."""
        self._sweep.abort(self._clock.now_s or 0.0)

    def set_estimator(self, estimator: FlowEstimator, calibration_age_s: float | None) -> None:
        """New parameters from outside; calibration_age_s: time since they were calibrated, None where it is not known."""
        self._estimator = estimator
        self._calibration_age_s = calibration_age_s

    def ticket(self, load_number: int, mass_kg: float, std_dev_kg: float) -> ReferenceMass:
        """A scale ticket for a load; returns the reference mass kept for the next calibration.

        Raises ValueError when the load is not known or a number makes no sense.
        """
        if not (isfinite(mass_kg) and mass_kg > 0.0):
            raise ValueError(f"ticket for load {load_number}: mass {mass_kg} kg; expected a mass above 0 kg")
        if not (isfinite(std_dev_kg) and std_dev_kg > 0.0):
            raise ValueError(f"ticket for load {load_number}: standard deviation {std_dev_kg} kg; expected above 0 kg")
        for load in reversed(self.loads):
            if load.number == load_number:
                end_s = load.end_s if isfinite(load.end_s) else self._bus_now()
                anchor = ReferenceMass(
                    AnchorSource.TICKET, load.start_s, end_s, mass_kg, std_dev_kg, load.measured_kg, load.complete, load_number
                )
                self._tickets.append(anchor)
                return anchor
        known = sorted(load.number for load in self.loads)
        raise ValueError(f"ticket for load {load_number}: no such load; expected one of {known}")

    def report_fault(self, code: FaultCode, present: bool, detail: str = "") -> None:
        """A condition that the service sees (bus error, store failing, output conflict, ...); holds until reported gone."""
        self.faults.report(code, present, detail)

    @property
    def estimator(self) -> FlowEstimator:
        """The estimator in use."""
        return self._estimator

    @property
    def outcome(self) -> CalibrationOutcome | None:
        """What the last whole sweep taught."""
        return self._outcome

    @property
    def sweep(self) -> SweepMachine:
        """The sweep, to look at."""
        return self._sweep

    @property
    def anchors(self) -> tuple[ReferenceMass, ...]:
        """Reference masses kept, by time."""
        return tuple(sorted((*self._scale.anchors, *self._tickets), key=lambda anchor: anchor.end_s))

    @property
    def loads(self) -> tuple[LoadSummary, ...]:
        """Loads completed since the start, and the open one."""
        return (*self._loads, self._load_summary(_NAN)) if self.totals.load_open else tuple(self._loads)

    @property
    def last_record(self) -> WindowRecord | None:
        """The last window."""
        return self._last_record

    def take_records(self) -> list[WindowRecord]:
        """Windows since the last call, at most the last two hours."""
        records = list(self._records)
        self._records.clear()
        return records

    def snapshot(self) -> EngineState:
        """What is to outlive a restart."""
        return EngineState(
            totals=self.totals,
            zero=self._zero.state,
            windows=self._windows,
            sweep_id=self._sweep.sweep_id,
            sweep_due_in_s=self._sweep.remaining_s(self._clock.now_s or 0.0),
            calibration_age_s=self._calibration_age_s,
            parameter_version=self._estimator.parameters.version,
        )

    def restore(self, state: EngineState) -> None:
        """Go on from a snapshot; to be called before the first frame."""
        self.totals = state.totals
        self._zero.state = state.zero
        self._windows = state.windows
        self._sweep.sweep_id = state.sweep_id
        self._sweep.first_after_s = max(self.settings.sweep.first_after_s, state.sweep_due_in_s)
        self._calibration_age_s = state.calibration_age_s

    # Inputs

    def _feed_merged(self, rows: NDArray[np.float64], others: Sequence[Frame], places: NDArray[np.intp]) -> list[Frame]:
        out: list[Frame] = []
        first = 0
        for frame, place in zip(others, places.tolist(), strict=True):
            for row in rows[first:place]:
                out += self._feed_row(row)
            first = place
            out += self.feed(frame)
        for row in rows[first:]:
            out += self._feed_row(row)
        return out

    def _feed_row(self, row: NDArray[np.float64]) -> list[Frame]:
        now = self._clock.engine_time(float(row[0]))
        if now is None:
            return []
        out = self._advance(now) if now >= self._next_s else []
        self._builder.rows.append((now, *row[1:].tolist()))
        return out

    def _on_samples(self, now: float, signals: Mapping[str, Value]) -> None:
        get = signals.get
        self._builder.rows.append(
            (
                now,
                get("SampleCounter"),
                get("SensorStatus"),
                get("Sample0"),
                get("Sample1"),
                get("Sample2"),
                get("Sample3"),
            )
        )

    def _on_speed(self, now: float, signals: Mapping[str, Value]) -> None:
        rpm = number(signals.get("ElevatorSpeed"))
        if 0.0 <= rpm <= _MAX_PLAUSIBLE_RPM:
            self._speed.set(now, rpm * RPM)
            self._builder.add_speed(now, rpm * RPM)

    def _on_feedback(self, now: float, signals: Mapping[str, Value]) -> None:
        state = number(signals.get("ActuatorState"))
        if state in (0.0, 1.0, 2.0, 3.0):
            self._actuator = ActuatorState(int(state))
        angle = number(signals.get("PlateAngle"))
        if 0.0 <= angle <= _MAX_PLAUSIBLE_ANGLE_DEG and self._actuator is not ActuatorState.FAULT:
            self._angle.set(now, angle)
            self._builder.add_angle(now, radians(angle))

    def _on_grain(self, now: float, signals: Mapping[str, Value]) -> None:
        moisture = number(signals.get("Moisture"))
        if 0.0 <= moisture < 100.0:
            self._moisture.set(now, moisture)
        weight = number(signals.get("TestWeight"))
        if weight > 0.0:
            self._test_weight.set(now, weight)

    def _on_scale(self, now: float, signals: Mapping[str, Value]) -> None:
        status = number(signals.get("TankScaleStatus"))
        mass = number(signals.get("TankMass"))
        if isfinite(status):
            self._scale_status.set(now, status)
        if status == ScaleStatus.STABLE.value and isfinite(mass):
            self._scale.reading(now, mass)

    def _on_harvest_state(self, now: float, signals: Mapping[str, Value]) -> None:
        for held, name in ((self._header_down, "HeaderDown"), (self._working, "WorkState")):
            value = number(signals.get(name))
            if value in (0.0, 1.0):
                held.set(now, value)

    def _on_position(self, now: float, signals: Mapping[str, Value]) -> None:
        latitude, longitude = number(signals.get("Latitude")), number(signals.get("Longitude"))
        if abs(latitude) <= 90.0 and abs(longitude) <= 180.0:
            self._latitude.set(now, latitude)
            self._longitude.set(now, longitude)

    def _on_direction(self, now: float, signals: Mapping[str, Value]) -> None:
        course, speed = number(signals.get("CompassBearing")), number(signals.get("NavigationSpeed"))
        if 0.0 <= course <= 360.0:
            self._course.set(now, course)
        if speed >= 0.0:
            self._ground_speed.set(now, speed * _KMH)

    # Time

    def _advance(self, now: float) -> list[Frame]:
        """Do all that falls due up to now, in order of time."""
        if not self._begun:
            self._begin(now)
        out: list[Frame] = []
        while self._next_s <= now:
            at_s = self._next_s
            self._tick = self._next_tick
            if self._ticks_to_end(self._tick) == self._ticks_per_window:
                out += self._close_window(at_s)
            out += self._drive(at_s)
            self._plan_next()
        return out

    def _begin(self, now: float) -> None:
        self._begun = True
        # A first window shorter than half a second is joined to the next.
        half = self._ticks_per_window // 2
        earliest = floor(now * self._ticks_per_window / self.settings.windows.window_s) + half
        self._tick = earliest + self._ticks_to_end(earliest) - self._ticks_per_window
        self._window_start_s = now
        if not isfinite(self._load_start_s):
            self._load_start_s = self._bus_now()
        self._plan_next()

    def _plan_next(self) -> None:
        """What is due next: a tick while the plate is driven, else the end of the window."""
        ahead = 1 if self._sweep.driving else self._ticks_to_end(self._tick)
        self._next_tick = self._tick + ahead
        self._next_s = self._next_tick * self.settings.windows.window_s / self._ticks_per_window

    def _ticks_to_end(self, tick: int) -> int:
        """Ticks from a tick to the next end of a window after it."""
        return self._ticks_per_window - (tick - self._offset_ticks) % self._ticks_per_window

    def _bus_now(self) -> float:
        return _NAN if self._clock.now_s is None else self._clock.bus_time(self._clock.now_s)

    def _drive(self, at_s: float) -> list[Frame]:
        """Let the sweep say what it wants of the plate, and command it."""
        angle = self._angle.within(at_s, self.settings.inputs.feedback_timeout_s)
        demand = self._sweep.tick(PlateReading(at_s, angle, self._actuator))
        if demand is None:
            if not self._driving:
                return []
            demand = RELEASE
        self._driving = demand.mode is not CommandMode.RELEASE
        signals = self._commander.command(demand, angle)
        return [Frame(self._clock.bus_time(at_s), bus.PLATE_ACTUATOR_COMMAND, signals)]

    # Windows

    def _close_window(self, at_s: float) -> list[Frame]:
        stale_angle = not isfinite(self._angle.within(at_s, self.settings.inputs.feedback_timeout_s))
        if stale_angle and (self._actuator is ActuatorState.MOVING or self._driving):
            self._builder.forget_angle()
        window = self._builder.close(self._window_start_s, at_s)
        self._window_start_s = at_s
        self._windows += 1
        seconds = window.end_s - window.start_s
        if self._calibration_age_s is not None:
            self._calibration_age_s += seconds
        timeout_s = self.settings.inputs.speed_timeout_s
        speed_known = isfinite(self._speed.within(at_s, timeout_s))
        # With everything silent, what the last window left over was still measured at a known speed.
        speed_was_known = speed_known or isfinite(self._speed.within(self._builder.last_frame_s, timeout_s))
        moisture = self._moisture.within(at_s, self.settings.inputs.condition_timeout_s)
        in_range = self.machine.min_elevator_speed_rad_s <= window.speed_rad_s <= self.machine.max_elevator_speed_rad_s
        still = window.plate_max_rad - window.plate_min_rad <= radians(2.0 * self.settings.plate.at_target_tolerance_deg)
        self._stuck = self._stuck + 1 if window.samples and window.span_mv == 0.0 and in_range else 0
        stuck = self._stuck >= self.settings.faults.stuck_windows
        idle_s = self._idle_s(at_s)

        flow = self._flow(window, speed_was_known, in_range, stuck, stale_angle, moisture, idle_s)
        at_home = abs(window.plate_angle_rad - self.machine.home_plate_angle_rad) <= radians(
            2.0 * self.settings.plate.at_target_tolerance_deg
        )
        self._follow_zero(window, speed_known and in_range and not stuck, still and at_home)

        mass_kg = self._count(window, flow, moisture)
        self._scale.window(window.start_s, window.end_s, self.totals.total_kg - mass_kg, mass_kg, _measured(flow))
        sweep_step = self._sweep.window(
            SweepWindow(
                end_s=at_s,
                support_start_s=window.start_s - self._ramp_s(window),
                flow_kg_s=flow.rate_kg_s,
                force_n=flow.force_n,
                speed_rad_s=window.speed_rad_s,
                angle_deg=degrees(window.plate_angle_rad),
                whole=window.coverage >= self.settings.windows.full_coverage and not flow.saturated and window.lost_frames == 0,
                still=still,
                trend=window.trend,
            )
        )
        bus_s = self._clock.bus_time(at_s)
        self._judge_faults(bus_s, at_s, window, flow, speed_known, in_range, stuck, stale_angle)
        state = self._operating_state(window, speed_known)
        published = self._filtered(window, flow, still and at_home)
        record = self._record(bus_s, window, published, state, mass_kg, moisture, still, sweep_step)
        self._records.append(record)
        self._last_record = record
        self._learn(at_s, record)
        return self._report(bus_s, record)

    def _flow(
        self,
        window: Window,
        speed_known: bool,
        in_range: bool,
        stuck: bool,
        stale_angle: bool,
        moisture_pct: float,
        idle_s: float,
    ) -> _Flow:
        """Gate, force and flow of a window."""
        quality = EstimateQuality
        zero = self._zero.state
        if zero is None or not window.covered_s > 0.0 or not speed_known or stuck:
            return _Flow(_NAN, _NAN, quality.NOT_AVAILABLE, _NAN, _NAN)
        gain = self.machine.sensor.gain_n_per_mv
        force = (window.mean_mv - zero.zero_mv) * gain
        noise = self._force_std_dev(window, force)
        gate = GateInputs(
            force, self._zero.pulses(window), self._zero.looks_empty, self._zero.looks_loaded, in_range, idle_s
        )
        grain = self._gate.grain(gate)
        if not self._gate.see(gate):
            found = quality.NOT_AVAILABLE if grain and not in_range else quality.NOT_HARVESTING
            return _Flow(_NAN, _NAN, found, force, noise)
        held_long = window.held_s > 0.5 * self.settings.windows.window_s and abs(force) > self.settings.gate.grain_on_n
        if held_long:
            return _Flow(_NAN, _NAN, quality.NOT_AVAILABLE, force, noise)
        estimate = self._estimator.estimate(force, window.plate_angle_rad, window.speed_rad_s, noise, moisture_pct)
        rate, std_dev = float(estimate.mass_flow_kg_s), float(estimate.std_dev_kg_s)
        status = FlowStatus(int(estimate.status))
        if status is FlowStatus.SATURATED:
            rate, std_dev = self._full_paddle(force, window, noise, moisture_pct)
        if not (isfinite(rate) and isfinite(std_dev)) or rate < 0.0:
            return _Flow(_NAN, _NAN, quality.NOT_AVAILABLE, force, noise)
        away = abs(window.plate_angle_rad - self.machine.home_plate_angle_rad) > radians(
            2.0 * self.settings.plate.at_target_tolerance_deg
        )
        if stale_angle:
            std_dev = hypot(std_dev, self._angle_uncertainty(rate, force, window, noise, moisture_pct))
        if away:
            std_dev *= self.settings.sweep.max_std_dev_factor
        saturated = status is FlowStatus.SATURATED or window.saturated_share >= self.settings.windows.saturated_share
        degraded = (
            window.coverage < self.settings.windows.full_coverage
            or window.lost_frames > 0
            or window.surplus_frames > 0
            or window.sensor_fault_frames > 0
            or window.held_s > 0.25 * self.settings.windows.window_s
            or stale_angle
            or self.faults.is_active(FaultCode.CALIBRATION_OLD)
        )
        if saturated:
            found = quality.SATURATED
        elif away or self._sweep.visiting:
            found = quality.SWEEPING
        elif status is FlowStatus.OUTSIDE_CALIBRATION:
            found = quality.OUTSIDE_CALIBRATION
        elif degraded:
            found = quality.DEGRADED
        else:
            found = quality.OK
        outside = status is FlowStatus.OUTSIDE_CALIBRATION
        # An estimator that does not tell them apart: flow is nearly proportional to force, so a share of one is one of the other.
        own = estimate.noise_std_dev_kg_s
        window_noise = rate * noise / force if own is None and force > 0.0 else float(own) if own is not None else _NAN
        return _Flow(rate, std_dev, found, force, noise, outside, saturated, window_noise)

    def _filtered(self, window: Window, flow: _Flow, plate_rests_at_home: bool) -> _Flow:
        """The flow to publish: windows of a plate at rest at home weighed together; every other stands for itself."""
        usable = plate_rests_at_home and not flow.saturated and flow.force_n > 0.0 and flow.rate_kg_s > 0.0
        if not usable:
            self._filter.reset()
            return flow
        noise = flow.noise_kg_s
        common = max(0.0, flow.std_dev_kg_s**2 - noise**2) ** 0.5
        rate, std_dev = self._filter.update(flow.rate_kg_s, noise)
        return replace(flow, rate_kg_s=rate, std_dev_kg_s=hypot(std_dev, common * rate / flow.rate_kg_s))

    def _force_std_dev(self, window: Window, force_n: float) -> float:
        """Standard deviation of the mean force: scatter within the window, drawn towards the prior for paddle scatter, N."""
        settings = self.settings.windows
        gain = self.machine.sensor.gain_n_per_mv
        paddles = window.speed_rad_s * self.machine.sprocket_pitch_radius_m / self.machine.paddle_spacing_m * window.covered_s
        expected = settings.paddle_scatter * abs(force_n) / max(1.0, paddles) ** 0.5
        variance = expected**2
        if isfinite(window.std_dev_mv):
            seen = (window.std_dev_mv * gain) ** 2
            own, prior = float(window.patterns - 1), settings.scatter_prior_patterns
            variance = (own * seen + prior * variance) / (own + prior)
        variance /= max(window.coverage, 1e-3)
        return hypot(variance**0.5, settings.min_force_std_dev_n)

    def _full_paddle(self, force_n: float, window: Window, noise_n: float, moisture_pct: float) -> tuple[float, float]:
        """Largest flow that the model knows at a window's angle and speed: what a force above it says at least."""
        low, high = 0.0, force_n
        rate, std_dev = _NAN, _NAN
        for _ in range(12):
            middle = 0.5 * (low + high)
            estimate = self._estimator.estimate(middle, window.plate_angle_rad, window.speed_rad_s, noise_n, moisture_pct)
            if int(estimate.status) == FlowStatus.SATURATED:
                high = middle
            else:
                low = middle
                rate, std_dev = float(estimate.mass_flow_kg_s), float(estimate.std_dev_kg_s)
        return rate, std_dev

    def _angle_uncertainty(self, rate: float, force_n: float, window: Window, noise_n: float, moisture_pct: float) -> float:
        """Standard deviation of flow from a plate angle that is held, not measured, kg/s."""
        moved = window.plate_angle_rad - radians(self.settings.inputs.held_angle_std_dev_deg)
        estimate = self._estimator.estimate(force_n, moved, window.speed_rad_s, noise_n, moisture_pct)
        other = float(estimate.mass_flow_kg_s)
        return abs(other - rate) if isfinite(other) else rate

    def _follow_zero(self, window: Window, elevator_runs: bool, plate_rests_at_home: bool) -> None:
        whole = window.coverage >= self.settings.windows.full_coverage
        timeout_s = self.settings.inputs.vehicle_timeout_s
        header_down = self._header_down.within(window.end_s, timeout_s) == 1.0
        if header_down and self._working.within(window.end_s, timeout_s) != 0.0:
            self._cutting_s = window.end_s
        emptied = window.end_s - self._cutting_s >= self.settings.gate.emptying_s
        if elevator_runs and whole and plate_rests_at_home:
            self._zero.see(window, may_be_empty=not self._gate.harvesting and emptied)
        else:
            self._zero.interrupt()

    def _count(self, window: Window, flow: _Flow, moisture_pct: float) -> float:
        """Add a window to the totals; returns its mass, kg."""
        if not _measured(flow):
            if flow.quality is EstimateQuality.NOT_AVAILABLE:
                self._load_complete = False
            return 0.0
        enough = window.coverage >= self.settings.windows.min_coverage
        mass_kg = flow.rate_kg_s * (window.weight_s if enough else window.covered_s)
        if not enough:
            self._load_complete = False
        self.totals = self.totals.with_mass(mass_kg, dry_mass(mass_kg, moisture_pct, self.settings.totals))
        return mass_kg

    def _ramp_s(self, window: Window) -> float:
        """Length of the window's edges, s."""
        chain = window.speed_rad_s * self.machine.sprocket_pitch_radius_m
        longest = self.settings.windows.max_ramp_s
        return min(longest, self.machine.pattern_length_m / chain) if chain > 0.0 else longest

    def _idle_s(self, at_s: float) -> float:
        """How long header, work state or ground speed have said that no crop is taken in, s."""
        timeout = self.settings.inputs.vehicle_timeout_s
        idle = (
            self._header_down.within(at_s, timeout) == 0.0
            or self._working.within(at_s, timeout) == 0.0
            or self._ground_speed.within(at_s, timeout) < self.settings.gate.min_ground_speed_m_s
        )
        if not idle:
            self._idle_since_s = None
            return 0.0
        if self._idle_since_s is None:
            self._idle_since_s = at_s
        return at_s - self._idle_since_s

    def _judge_faults(
        self,
        bus_s: float,
        at_s: float,
        window: Window,
        flow: _Flow,
        speed_known: bool,
        in_range: bool,
        stuck: bool,
        stale_angle: bool,
    ) -> None:
        settings = self.settings
        rpm = window.speed_rad_s / RPM
        turning = speed_known and rpm > settings.gate.min_turning_rpm
        scale_heard = isfinite(self._scale_status.value)
        scale_status = self._scale_status.within(at_s, settings.inputs.scale_timeout_s)
        outcome = self._outcome
        if self._clock.jumps != self._jumps_seen:
            self._jump_shown = settings.faults.clock_jump_hold_windows
        self._jumps_seen = self._clock.jumps
        jumped = self._jump_shown > 0
        self._jump_shown = max(0, self._jump_shown - 1)
        reason = self._sweep.abort_reason
        present: dict[FaultCode, tuple[bool, str]] = {
            FaultCode.SENSOR_MISSING: (
                window.samples == 0 or 2 * window.sensor_fault_frames > window.frames,
                f"{window.samples} usable samples in the window",
            ),
            FaultCode.SENSOR_STUCK: (stuck, f"no change for {self._stuck} s"),
            FaultCode.SENSOR_SATURATED: (
                window.saturated_share >= settings.windows.saturated_share,
                f"{100.0 * window.saturated_share:.0f} % of the samples",
            ),
            FaultCode.ZERO_DRIFTED: (self._zero.drifted, ""),
            FaultCode.SPEED_MISSING: (not speed_known, ""),
            FaultCode.SPEED_OUT_OF_RANGE: (turning and not in_range, f"{rpm:.0f} rpm"),
            FaultCode.PLATE_NOT_FOLLOWING: (self._sweep.not_following, ""),
            FaultCode.PLATE_FEEDBACK_STALE: (stale_angle, ""),
            FaultCode.SWEEP_ABORTED: (reason is not None, reason.value if reason else ""),
            FaultCode.CALIBRATION_OLD: (
                self._calibration_age_s is not None and self._calibration_age_s > settings.faults.calibration_old_s,
                "",
            ),
            FaultCode.FLOW_OUTSIDE_CALIBRATION: (
                flow.out_of_calibration or (flow.saturated and window.saturated_share < settings.windows.saturated_share),
                f"{flow.rate_kg_s:.1f} kg/s",
            ),
            FaultCode.NOT_IDENTIFIABLE: (outcome is not None and not outcome.identifiable, outcome.reason if outcome else ""),
            FaultCode.MODEL_DISAGREES: (outcome is not None and outcome.disagrees, outcome.region if outcome else ""),
            FaultCode.FRAMES_LOST: (
                window.lost_frames > 0 or window.surplus_frames > 0 or 0.0 < window.coverage < settings.windows.full_coverage,
                f"{window.lost_frames} lost, {window.surplus_frames} too many",
            ),
            FaultCode.CLOCK_JUMPED: (jumped, ""),
            FaultCode.SCALE_FAULT: (
                scale_heard and (not isfinite(scale_status) or scale_status == ScaleStatus.FAULT.value),
                "silent" if not isfinite(scale_status) else "reports a fault",
            ),
        }
        for code in FAULTS:
            here, detail = present.get(code, (False, ""))
            self.faults.observe(code, here, bus_s, detail)

    def _operating_state(self, window: Window, speed_known: bool) -> OperatingState:
        if any(FAULTS[code].severity is Severity.STOP_TRUSTING for code in self.faults.active):
            return OperatingState.FAULT
        if not window.samples or not speed_known:
            return OperatingState.STARTING
        if self._zero.state is None or self._zero.calibrating:
            return OperatingState.ZEROING
        if self._sweep.driving:
            return OperatingState.SWEEPING
        return OperatingState.HARVESTING if self._gate.harvesting else OperatingState.NOT_HARVESTING

    def _record(
        self,
        bus_s: float,
        window: Window,
        flow: _Flow,
        state: OperatingState,
        mass_kg: float,
        moisture_pct: float,
        still: bool,
        sweep_step: int,
    ) -> WindowRecord:
        inputs = self.settings.inputs
        return WindowRecord(
            time_s=bus_s,
            window=self._windows,
            duration_s=window.weight_s,
            coverage=window.coverage,
            force_n=flow.force_n,
            force_std_dev_n=flow.force_std_dev_n,
            elevator_speed_rad_s=window.speed_rad_s,
            plate_angle_rad=window.plate_angle_rad,
            plate_still=still,
            moisture_pct=moisture_pct,
            test_weight_kg_m3=self._test_weight.within(window.end_s, inputs.condition_timeout_s),
            mass_flow_kg_s=flow.rate_kg_s,
            std_dev_kg_s=flow.std_dev_kg_s,
            quality=flow.quality,
            operating_state=state,
            mass_kg=mass_kg,
            load_kg=self.totals.load_kg,
            total_kg=self.totals.total_kg,
            load_number=self.totals.load_number,
            zero_mv=self._zero.state.zero_mv if self._zero.state else _NAN,
            pulse_mv=window.pulse_mv,
            saturated_share=window.saturated_share,
            lost_frames=window.lost_frames,
            surplus_frames=window.surplus_frames,
            repeated_frames=window.repeated_frames,
            sweep_id=self._sweep.sweep_id if sweep_step >= 0 or self._sweep.visiting else 0,
            sweep_step=sweep_step if sweep_step >= 0 else self._sweep.step,
            usable_for_calibration=sweep_step >= 0,
            parameter_version=self._estimator.parameters.version,
            faults=self.faults.active,
            latitude_deg=self._latitude.within(window.end_s, inputs.vehicle_timeout_s),
            longitude_deg=self._longitude.within(window.end_s, inputs.vehicle_timeout_s),
            ground_speed_m_s=self._ground_speed.within(window.end_s, inputs.vehicle_timeout_s),
            course_deg=self._course.within(window.end_s, inputs.vehicle_timeout_s),
        )

    def _learn(self, at_s: float, record: WindowRecord) -> None:
        """Collect a sweep's windows; at its end hand them to the calibrator and take what comes back."""
        if not self._sweep.visiting and not self._sweep.completed:
            self._sweep_records.clear()
            return
        if record.usable_for_calibration:
            self._sweep_records.append(record)
        if not self._sweep.completed:
            return
        records, self._sweep_records = self._sweep_records, []
        if self._sweep.lying_feedback():
            self._sweep.abort(at_s, SweepAbort.FORCE_DOES_NOT_FOLLOW)
            return
        updated = False
        if self._calibrator is not None:
            self._outcome = self._calibrator.update(records, self.anchors, self._estimator)
            if self._outcome.estimator is not None:
                self.set_estimator(self._outcome.estimator, 0.0)
                updated = True
        self._sweep.finish(at_s, updated)

    # Loads

    def _load_summary(self, end_s: float) -> LoadSummary:
        totals = self.totals
        return LoadSummary(
            totals.load_number,
            self._load_start_s,
            end_s,
            totals.load_kg,
            totals.load_dry_kg,
            totals.load_unknown_moisture_kg,
            self._load_complete,
        )

    def _close_load(self) -> None:
        if self.totals.load_open:
            self._loads.append(self._load_summary(self._bus_now()))

    # Output

    def _report(self, bus_s: float, record: WindowRecord) -> list[Frame]:
        """The frames of one window."""
        published = isfinite(record.mass_flow_kg_s) and record.coverage >= self.settings.windows.min_coverage
        quality = record.quality
        if not published and quality is not EstimateQuality.NOT_HARVESTING:
            quality = EstimateQuality.NOT_AVAILABLE
        active = record.faults
        status: dict[str, Value] = {"OperatingState": int(record.operating_state), **_NO_FAULTS}
        for code in active:
            status[code.value] = 1
        return [
            Frame(
                bus_s,
                bus.MASS_FLOW,
                {
                    "MassFlowRate": _fits(record.mass_flow_kg_s, 64.255) if published else NOT_AVAILABLE,
                    "MassFlowStdDev": _fits(record.std_dev_kg_s, 64.255) if published else NOT_AVAILABLE,
                    "EstimateQuality": int(quality),
                    "WindowCounter": record.window % _COUNTER_MODULUS,
                },
            ),
            Frame(
                bus_s,
                bus.ACCUMULATED_MASS,
                {
                    "LoadMass": _fits(record.load_kg, 164495.35),
                    "TotalMass": _fits(record.total_kg, 42110812.15),
                    "LoadNumber": record.load_number % _COUNTER_MODULUS,
                },
            ),
            Frame(bus_s, bus.SELF_CALIBRATION_STATUS, self._calibration_signals()),
            Frame(bus_s, bus.YIELD_MONITOR_STATUS, status),
            Frame(bus_s, bus.ACTIVE_DIAGNOSTICS, self._diagnostic_signals(active)),
        ]

    def _calibration_signals(self) -> dict[str, Value]:
        values = self._estimator.parameters.values
        gain = 1.0 + values["restitution"] if "restitution" in values else values["k1"] + values["k2"]
        age = self._calibration_age_s
        return {
            "SweepState": int(self._sweep.state),
            "SweepProgress": self._sweep.progress_pct,
            "Friction": _fits(values["friction"], 6.4255),
            "ImpactGain": _fits(gain, 32.1275),
            "CalibrationAge": NOT_AVAILABLE if age is None else _fits(floor(age / 60.0), 1028095),
        }

    def _diagnostic_signals(self, active: tuple[FaultCode, ...]) -> dict[str, Value]:
        """One trouble code; with several active they take turns."""
        severities = [FAULTS[code].severity for code in active]
        signals: dict[str, Value] = {
            "ProtectLamp": 0,
            "AmberWarningLamp": int(Severity.WARNING in severities or Severity.STOP_TRUSTING in severities),
            "RedStopLamp": 0,
            "MalfunctionLamp": 0,
            "ConversionMethod": 0,
        }
        if not active:
            signals.update(SuspectParameterLow=0, SuspectParameterHigh=0, FailureMode=0, OccurrenceCount=0)
            return signals
        code = active[self._diagnostic % len(active)]
        self._diagnostic += 1
        definition = FAULTS[code]
        signals.update(
            SuspectParameterLow=definition.spn & 0xFFFF,
            SuspectParameterHigh=definition.spn >> 16,
            FailureMode=definition.fmi,
            OccurrenceCount=min(126, self.faults.occurrences(code)),
        )
        return signals


def _measured(flow: _Flow) -> bool:
    return isfinite(flow.rate_kg_s)


def _fits(value: float, largest: float) -> Value:
    """The value where the signal can carry it; beyond that it is not available, never cut off."""
    return value if 0.0 <= value <= largest else NOT_AVAILABLE
