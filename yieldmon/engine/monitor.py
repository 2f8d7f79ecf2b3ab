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
from dataclasses import dataclass, replace
from functools import partial
from math import degrees, floor, hypot, isfinite, radians
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yieldmon import frames as bus
from yieldmon.engine.anchors import AnchorSource, ReferenceMass, TankScale
from yieldmon.engine.clock import BusClock
from yieldmon.engine.disagreement import Disagreement
from yieldmon.engine.faults import FAULTS, FaultBook, FaultCode, Severity
from yieldmon.engine.flow_filter import FlowFilter
from yieldmon.engine.gates import GateInputs, HarvestGate
from yieldmon.engine.inputs import DEGREE, Inputs, Moment, RunInputs
from yieldmon.engine.plate_commands import RELEASE, PlateCommander
from yieldmon.engine.records import CalibrationOutcome, FlowEstimator, SelfCalibrator, WindowRecord
from yieldmon.engine.runs import FrameRun
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.state import EngineState
from yieldmon.engine.sweep import PlateReading, SweepAbort, SweepMachine, SweepWindow
from yieldmon.engine.totals import Totals, dry_mass
from yieldmon.engine.windows import Window, WindowBuilder
from yieldmon.engine.zero import ZeroState, ZeroTracker
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
_FORMED_TOGETHER = 16
"""Windows of a run that are formed at once: enough to share the cost of array operations, few enough for the cache."""
_ESTIMATED_TOGETHER = 64
"""The same for flow estimates."""
_KEPT_RECORDS = 7200
_KEPT_LOADS = 256
_COUNTER_MODULUS = 256
_NO_FAULTS: dict[str, Value] = {code.value: 0 for code in FAULTS}


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


@dataclass(frozen=True, slots=True)
class _Reading:
    """What is known of a window before its flow is estimated, and what zero and gate made of it.

    flow: None where an estimate decides. stuck_s: how long no sample has changed. still: the plate rested. speed_known: at the
    window's end; in_range: at a speed at which grain is measured.
    """

    window: Window
    moment: Moment
    flow: _Flow | None
    force_n: float
    force_std_dev_n: float
    speed_known: bool
    in_range: bool
    stuck_s: int
    stale_angle: bool
    still: bool
    at_home: bool
    harvesting: bool
    zero: ZeroState | None
    zero_drifted: bool
    calibrating_zero: bool


class _Estimate(NamedTuple):
    """One row of a FlowEstimate; noise_kg_s is None where the estimator does not tell it apart."""

    rate_kg_s: float
    std_dev_kg_s: float
    status: FlowStatus
    noise_kg_s: float | None


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
        self.disagreement = Disagreement(settings.disagreement, machine)
        self._scale = TankScale(settings.anchors)
        self._tickets: deque[ReferenceMass] = deque(maxlen=settings.anchors.keep)
        self._weights_new = False
        self._ticks_per_window = round(settings.windows.window_s / settings.plate.command_interval_s)
        self._offset_ticks = round(settings.windows.grid_offset_s / settings.plate.command_interval_s)
        self._begun = False
        self._tick = self._next_tick = 0
        self._next_s = float("-inf")
        self._window_start_s = 0.0
        self._inputs = Inputs(settings.inputs)
        self._weighed_s = float("-inf")
        self._idle_since_s: float | None = None
        self._cutting_s = float("-inf")
        self._windows = 0
        self._stuck = 0
        self._sampled = False
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
        self._reporting = True
        self._rest_rad = radians(2.0 * settings.plate.at_target_tolerance_deg)
        self._diagnostic = 0

    # Frames

    def feed(self, frame: Frame) -> list[Frame]:
        """Take one frame; returns what is to be sent, in order, usually nothing."""
        now = self._clock.engine_time(frame.time_s)
        if now is None:
            return []
        out = self._advance(now) if now >= self._next_s else []
        self._take(now, frame.message, frame.signals)
        return out

    def tick(self, time_s: float) -> list[Frame]:
        """Bus time has come to time_s (s) without a frame of ours; returns what is to be sent."""
        now = self._clock.engine_time(time_s)
        return [] if now is None else self._advance(now)

    def feed_run(self, run: FrameRun, *, reports: bool = True) -> list[Frame]:
        """Take a run of frames: the same as `feed` frame by frame, to the bit, at a fraction of its cost.

        reports: False leaves out the frames that tell of a window, which a log's reader has no use for.
        """
        if not run.times_s.size:
            return []
        self._reporting = reports
        try:
            if self._clock.now_s is None:
                start = self._clock.engine_time(float(run.times_s[0]))
                if start is not None:
                    self._advance(start)
            return self._feed_regular(run) if self._clock.regular(run.times_s) else self._feed_one_by_one(run)
        finally:
            self._reporting = True

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
        """Other parameters; calibration_age_s: time since they were calibrated, None where it is not known."""
        self._estimator = estimator
        self._calibration_age_s = calibration_age_s

    def ticket(self, load_number: int, mass_kg: float, std_dev_kg: float) -> ReferenceMass:
        """A scale ticket for a load; returns the reference mass, which teaches when the window or sweep under way ends.

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
                self._weights_new = True
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
        """What the last whole sweep or weighed mass taught."""
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
    def due_s(self) -> float:
        """Bus time of the first frame that will make `feed` do more than take note of it; -inf before the first frame."""
        return self._clock.bus_time(self._next_s)

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
            disagreement=self.disagreement.state,
            calibrator=self._calibrator.snapshot(self._bus_now(), self.totals.total_kg) if self._calibrator is not None else None,
        )

    def restore(self, state: EngineState) -> None:
        """Go on from a snapshot; to be called before the first frame."""
        self.totals = state.totals
        # What passed between the snapshot and now was not measured.
        self._load_complete = not (state.totals.load_open and state.totals.load_kg > 0.0)
        self._zero.state = state.zero
        self._windows = state.windows
        self._sweep.sweep_id = state.sweep_id
        self._sweep.first_after_s = max(self.settings.sweep.first_after_s, state.sweep_due_in_s)
        self._calibration_age_s = state.calibration_age_s
        # Where other parameters came from outside meanwhile, the patterns seen so far say nothing about them.
        if state.parameter_version == self._estimator.parameters.version:
            self.disagreement.restore(state.disagreement, self._estimator.parameters)
            if state.calibrator is not None and self._calibrator is not None:
                self._calibrator.restore(state.calibrator, self._estimator.parameters, state.totals.total_kg)

    # Inputs

    def _take(self, now: float, message: str, signals: Mapping[str, Value]) -> None:
        if message == bus.IMPACT_SENSOR_SAMPLES:
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
        elif self._inputs.take(message, now, signals):
            if message == bus.ELEVATOR_SPEED:
                self._builder.add_speed(now, self._inputs.held["speed_rad_s"].value)
            else:
                self._builder.add_angle(now, self._inputs.held["angle_deg"].value * DEGREE)

    def _feed_one_by_one(self, run: FrameRun) -> list[Frame]:
        others = {place: frame for part in run.others for place, frame in part.frames()}
        out: list[Frame] = []
        samples = iter(run.samples.tolist())
        for place, time_s in enumerate(run.times_s.tolist()):
            if place in others:
                out += self.feed(others[place])
                continue
            row = next(samples)
            now = self._clock.engine_time(time_s)
            if now is not None:
                out += self._advance(now) if now >= self._next_s else []
                self._builder.rows.append((now, *row))
        return out

    def _feed_regular(self, run: FrameRun) -> list[Frame]:
        """A run whose times neither step back nor jump: its windows are closed a group at a time."""
        offset_s = self._clock.offset_s
        last_s = float(run.times_s[-1]) + offset_s
        inputs = self._inputs.follow(run, offset_s)
        feeding = _Feeding(self._builder, run, offset_s, inputs)
        ends = self._window_ends(last_s)
        moments = inputs.moments(ends)
        out: list[Frame] = []
        first = 0
        while first < len(ends):
            last = first + 1
            if not _stale(moments[first]):
                while last < min(len(ends), first + _ESTIMATED_TOGETHER) and not _stale(moments[last]):
                    last += 1
            out += self._close_windows(moments[first:last], feeding)
            first = last
        feeding.rest()
        while self._next_s <= last_s:
            out += self._due(*inputs.plate_at(self._next_s))
        inputs.finish()
        self._clock.now_s = last_s
        return out

    # Time

    def _advance(self, now: float) -> list[Frame]:
        """Do all that falls due up to now, in order of time."""
        if not self._begun:
            self._begin(now)
        out: list[Frame] = []
        while self._next_s <= now:
            moment = self._inputs.moment(self._next_s)
            if self._ticks_to_end(self._next_tick) == self._ticks_per_window:
                out += self._close_windows([moment])
            else:
                out += self._due(moment.angle_deg, self._inputs.actuator)
        return out

    def _due(self, angle_deg: float, actuator: ActuatorState) -> list[Frame]:
        """The tick that is due, the plate being at angle_deg (nan: unknown)."""
        at_s = self._next_s
        self._tick = self._next_tick
        out = self._drive(at_s, angle_deg, actuator)
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

    def _window_ends(self, last_s: float) -> list[float]:
        """Ends of windows that fall due until last_s, engine time."""
        ends: list[float] = []
        tick = self._tick
        while True:
            tick += self._ticks_to_end(tick)
            end_s = tick * self.settings.windows.window_s / self._ticks_per_window
            if end_s > last_s:
                return ends
            ends.append(end_s)

    def _ticks_to_end(self, tick: int) -> int:
        """Ticks from a tick to the next end of a window after it."""
        return self._ticks_per_window - (tick - self._offset_ticks) % self._ticks_per_window

    def _bus_now(self) -> float:
        return _NAN if self._clock.now_s is None else self._clock.bus_time(self._clock.now_s)

    def _drive(self, at_s: float, angle_deg: float, actuator: ActuatorState) -> list[Frame]:
        """Let the sweep say what it wants of the plate, and command it."""
        demand = self._sweep.tick(PlateReading(at_s, angle_deg, actuator))
        if demand is None:
            if not self._driving:
                return []
            demand = RELEASE
        self._driving = demand.mode is not CommandMode.RELEASE
        signals = self._commander.command(demand, angle_deg)
        return [Frame(self._clock.bus_time(at_s), bus.PLATE_ACTUATOR_COMMAND, signals)]

    # Windows

    def _close_windows(self, moments: Sequence[Moment], feeding: _Feeding | None = None) -> list[Frame]:
        """Close the windows that end at these moments, one after the other.

        What a window is worth is worked out for all of them together, in three passes: zero, gate and force, each after the one
        before; the estimates, which know nothing of each other; all the rest, in order again. feeding: what comes before their
        ends and is not with the builder yet. Where the angle is stale at an end, that window comes alone.
        """
        out: list[Frame] = []
        if feeding is not None:
            out += self._ticks_before(moments[0].time_s, feeding)
        first = moments[0]
        if _stale(first) and (first.actuator == ActuatorState.MOVING or self._driving):
            if feeding is not None:
                feeding.up_to(first.time_s)
            self._builder.forget_angle()
        readings = []
        for start in range(0, len(moments), _FORMED_TOGETHER):
            part = moments[start : start + _FORMED_TOGETHER]
            if feeding is not None:
                feeding.up_to(part[-1].time_s)
            windows = self._builder.close_run([self._window_start_s, *(moment.time_s for moment in part)])
            self._window_start_s = part[-1].time_s
            readings += [self._read(window, moment) for window, moment in zip(windows, part, strict=True)]
        estimator, estimates = self._estimator, self._estimates(readings)
        for index, reading in enumerate(readings):
            if self._estimator is not estimator:
                estimator = self._estimator
                estimates[index:] = self._estimates(readings[index:])
            if feeding is not None:
                out += self._ticks_before(reading.window.end_s, feeding)
            out += self._conclude(reading, estimates[index])
            out += self._due(reading.moment.angle_deg, ActuatorState(reading.moment.actuator))
        return out

    def _ticks_before(self, end_s: float, feeding: _Feeding) -> list[Frame]:
        out: list[Frame] = []
        while self._next_s < end_s:
            out += self._due(*feeding.inputs.plate_at(self._next_s))
        return out

    def _read(self, window: Window, moment: Moment) -> _Reading:
        """Zero, gate and force of a window, which come before its flow."""
        settings = self.settings
        # With everything silent, what the last window left over was still measured at a known speed.
        timeout_s = settings.inputs.speed_timeout_s
        speed_was_known = moment.speed_known or window.last_frame_s - moment.speed_time_s <= timeout_s
        in_range = self.machine.min_elevator_speed_rad_s <= window.speed_rad_s <= self.machine.max_elevator_speed_rad_s
        still = window.plate_max_rad - window.plate_min_rad <= self._rest_rad
        at_home = abs(window.plate_angle_rad - self.machine.home_plate_angle_rad) <= self._rest_rad
        self._stuck = self._stuck + 1 if window.samples and window.span_mv == 0.0 and in_range else 0
        stuck = self._stuck >= settings.faults.stuck_windows
        idle_s = self._idle_s(moment)
        flow, force, noise = self._gated(window, speed_was_known, in_range, stuck, idle_s)
        self._follow_zero(window, moment, moment.speed_known and in_range and not stuck, still and at_home)
        return _Reading(
            window=window,
            moment=moment,
            flow=flow,
            force_n=force,
            force_std_dev_n=noise,
            speed_known=moment.speed_known,
            in_range=in_range,
            stuck_s=self._stuck,
            stale_angle=_stale(moment),
            still=still,
            at_home=at_home,
            harvesting=self._gate.harvesting,
            zero=self._zero.state,
            zero_drifted=self._zero.drifted,
            calibrating_zero=self._zero.calibrating,
        )

    def _gated(
        self, window: Window, speed_known: bool, in_range: bool, stuck: bool, idle_s: float
    ) -> tuple[_Flow | None, float, float]:
        """The flow of a window that needs no estimate (else None), its force and the force's standard deviation, N."""
        quality = EstimateQuality
        zero = self._zero.state
        if zero is None or not window.covered_s > 0.0 or not speed_known or stuck:
            return _Flow(_NAN, _NAN, quality.NOT_AVAILABLE, _NAN, _NAN), _NAN, _NAN
        gain = self.machine.sensor.gain_n_per_mv
        force = (window.mean_mv - zero.zero_mv) * gain
        noise = self._force_std_dev(window, force)
        gate = GateInputs(
            force, self._zero.pulses(window), self._zero.looks_empty, self._zero.looks_loaded, in_range, idle_s
        )
        grain = self._gate.grain(gate)
        if not self._gate.see(gate):
            found = quality.NOT_AVAILABLE if grain and not in_range else quality.NOT_HARVESTING
            return _Flow(_NAN, _NAN, found, force, noise), force, noise
        held_long = window.held_s > 0.5 * self.settings.windows.window_s and abs(force) > self.settings.gate.grain_on_n
        if held_long:
            return _Flow(_NAN, _NAN, quality.NOT_AVAILABLE, force, noise), force, noise
        return None, force, noise

    def _estimates(self, readings: Sequence[_Reading]) -> list[_Estimate | None]:
        """The estimator's word on each window that needs one, asked for all at once."""
        open_flow = [reading for reading in readings if reading.flow is None]
        if not open_flow:
            return [None] * len(readings)
        inputs = np.array(
            [
                (r.force_n, r.window.plate_angle_rad, r.window.speed_rad_s, r.force_std_dev_n, r.moment.moisture_pct)
                for r in open_flow
            ]
        ).T.copy()
        found = self._estimator.estimate(*inputs)
        size = len(open_flow)
        columns = [
            np.broadcast_to(column, size).tolist() if column is not None else [None] * size
            for column in (found.mass_flow_kg_s, found.std_dev_kg_s, found.status, found.noise_std_dev_kg_s)
        ]
        rows = (_Estimate(rate, sd, FlowStatus(status), own) for rate, sd, status, own in zip(*columns, strict=True))
        return [next(rows) if reading.flow is None else None for reading in readings]

    def _conclude(self, reading: _Reading, estimate: _Estimate | None) -> list[Frame]:
        """All that follows from a window's flow: totals, sweep, faults, the record and the frames that tell of it."""
        window, moment = reading.window, reading.moment
        at_s = window.end_s
        self._windows += 1
        if self._calibration_age_s is not None:
            self._calibration_age_s += at_s - window.start_s
        flow = reading.flow if estimate is None else self._flow(reading, estimate)
        assert flow is not None
        mass_kg = self._count(window, flow, moment.moisture_pct)
        if moment.tank_time_s != self._weighed_s:
            self._weighed_s = moment.tank_time_s
            self._scale.reading(moment.tank_time_s, moment.tank_kg)
        weighed = self._scale.window(window.start_s, at_s, self.totals.total_kg - mass_kg, mass_kg, _measured(flow))
        self._weights_new = self._weights_new or weighed
        sweep_step = self._sweep.window(
            SweepWindow(
                end_s=at_s,
                support_start_s=window.start_s - self._ramp_s(window),
                flow_kg_s=flow.rate_kg_s,
                force_n=flow.force_n,
                speed_rad_s=window.speed_rad_s,
                angle_deg=degrees(window.plate_angle_rad),
                whole=window.coverage >= self.settings.windows.full_coverage and not flow.saturated and window.lost_frames == 0,
                still=reading.still,
                trend=window.trend,
            )
        )
        bus_s = self._clock.bus_time(at_s)
        self._judge_faults(bus_s, reading, flow)
        published = self._filtered(flow, reading.still and reading.at_home)
        record = self._record(bus_s, reading, published, mass_kg, sweep_step)
        self._records.append(record)
        self._last_record = record
        self._learn(at_s, record)
        return self._report(bus_s, record) if self._reporting else []

    def _flow(self, reading: _Reading, estimate: _Estimate) -> _Flow:
        """Flow of a window from what the estimator says of it."""
        quality = EstimateQuality
        window, force, noise, moisture_pct = reading.window, reading.force_n, reading.force_std_dev_n, reading.moment.moisture_pct
        rate, std_dev, status, own = estimate
        if status is FlowStatus.SATURATED:
            rate, std_dev = self._full_paddle(force, window, noise, moisture_pct)
        if not (isfinite(rate) and isfinite(std_dev)) or rate < 0.0:
            return _Flow(_NAN, _NAN, quality.NOT_AVAILABLE, force, noise)
        away = not reading.at_home
        if reading.stale_angle:
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
            or reading.stale_angle
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
        window_noise = rate * noise / force if own is None and force > 0.0 else own if own is not None else _NAN
        return _Flow(rate, std_dev, found, force, noise, outside, saturated, window_noise)

    def _filtered(self, flow: _Flow, plate_rests_at_home: bool) -> _Flow:
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

    def _follow_zero(self, window: Window, moment: Moment, elevator_runs: bool, plate_rests_at_home: bool) -> None:
        whole = window.coverage >= self.settings.windows.full_coverage
        if moment.header_down == 1.0 and moment.working != 0.0:
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

    def _idle_s(self, moment: Moment) -> float:
        """How long header, work state or ground speed have said that no crop is taken in, s."""
        at_s = moment.time_s
        idle = (
            moment.header_down == 0.0
            or moment.working == 0.0
            or moment.ground_speed_m_s < self.settings.gate.min_ground_speed_m_s
        )
        if not idle:
            self._idle_since_s = None
            return 0.0
        if self._idle_since_s is None:
            self._idle_since_s = at_s
        return at_s - self._idle_since_s

    def _judge_faults(self, bus_s: float, reading: _Reading, flow: _Flow) -> None:
        settings, window, moment = self.settings, reading.window, reading.moment
        # A sensor that starts or stops within a window covers a part of it and has lost nothing.
        began, self._sampled = not self._sampled, window.coverage > 0.0
        ended = window.end_s - window.last_frame_s > settings.inputs.sensor_timeout_s
        rpm = window.speed_rad_s / RPM
        turning = reading.speed_known and rpm > settings.gate.min_turning_rpm
        saturated = window.saturated_share >= settings.windows.saturated_share
        counted = window.lost_frames > 0 or window.surplus_frames > 0
        old = self._calibration_age_s is not None and self._calibration_age_s > settings.faults.calibration_old_s
        scale_silent = not isfinite(moment.fresh_scale_status)
        scale_fault = scale_silent or moment.fresh_scale_status == ScaleStatus.FAULT.value
        outcome, disagreement = self._outcome, self.disagreement
        vague = outcome is not None and not outcome.identifiable
        if self._clock.jumps != self._jumps_seen:
            self._jump_shown = settings.faults.clock_jump_hold_windows
        self._jumps_seen = self._clock.jumps
        jumped = self._jump_shown > 0
        self._jump_shown = max(0, self._jump_shown - 1)
        reason = self._sweep.abort_reason
        verdicts: tuple[tuple[FaultCode, bool, str, tuple[object, ...]], ...] = (
            (
                FaultCode.SENSOR_MISSING,
                window.samples == 0 or 2 * window.sensor_fault_frames > window.frames,
                "{} usable samples in the window",
                (window.samples,),
            ),
            (FaultCode.SENSOR_STUCK, reading.stuck_s >= settings.faults.stuck_windows, "no change for {} s", (reading.stuck_s,)),
            (FaultCode.SENSOR_SATURATED, saturated, "{:.0f} % of the samples", (100.0 * window.saturated_share,)),
            (FaultCode.ZERO_DRIFTED, reading.zero_drifted, "", ()),
            (FaultCode.SPEED_MISSING, not reading.speed_known, "", ()),
            (FaultCode.SPEED_OUT_OF_RANGE, turning and not reading.in_range, "{:.0f} rpm", (rpm,)),
            (FaultCode.PLATE_NOT_FOLLOWING, self._sweep.not_following, "", ()),
            (FaultCode.PLATE_FEEDBACK_STALE, reading.stale_angle, "", ()),
            (FaultCode.SWEEP_ABORTED, reason is not None, "{}", (reason,)),
            (FaultCode.CALIBRATION_OLD, old, "", ()),
            (
                FaultCode.FLOW_OUTSIDE_CALIBRATION,
                flow.out_of_calibration or (flow.saturated and not saturated),
                "{:.1f} kg/s",
                (flow.rate_kg_s,),
            ),
            (FaultCode.NOT_IDENTIFIABLE, vague, "{}", (outcome.reason if outcome else "",)),
            (FaultCode.MODEL_DISAGREES, disagreement.present, "{}", (disagreement.region,)),
            (
                FaultCode.FRAMES_LOST,
                counted or (0.0 < window.coverage < settings.windows.full_coverage and not (began or ended)),
                "{} lost, {} too many",
                (window.lost_frames, window.surplus_frames),
            ),
            (FaultCode.CLOCK_JUMPED, jumped, "", ()),
            (
                FaultCode.SCALE_FAULT,
                isfinite(moment.scale_status) and scale_fault,
                "silent" if scale_silent else "reports a fault",
                (),
            ),
        )
        self.faults.observe_all({code: text.format(*of) for code, holds, text, of in verdicts if holds}, bus_s)

    def _operating_state(self, reading: _Reading, active: tuple[FaultCode, ...]) -> OperatingState:
        if any(FAULTS[code].severity is Severity.STOP_TRUSTING for code in active):
            return OperatingState.FAULT
        if not reading.window.samples or not reading.speed_known:
            return OperatingState.STARTING
        if reading.zero is None or reading.calibrating_zero:
            return OperatingState.ZEROING
        if self._sweep.driving:
            return OperatingState.SWEEPING
        return OperatingState.HARVESTING if reading.harvesting else OperatingState.NOT_HARVESTING

    def _record(self, bus_s: float, reading: _Reading, flow: _Flow, mass_kg: float, sweep_step: int) -> WindowRecord:
        window, moment, active = reading.window, reading.moment, self.faults.active
        return WindowRecord(
            time_s=bus_s,
            window=self._windows,
            duration_s=window.weight_s,
            coverage=window.coverage,
            force_n=flow.force_n,
            force_std_dev_n=flow.force_std_dev_n,
            elevator_speed_rad_s=window.speed_rad_s,
            plate_angle_rad=window.plate_angle_rad,
            plate_still=reading.still,
            moisture_pct=moment.moisture_pct,
            test_weight_kg_m3=moment.test_weight_kg_m3,
            mass_flow_kg_s=flow.rate_kg_s,
            std_dev_kg_s=flow.std_dev_kg_s,
            quality=flow.quality,
            operating_state=self._operating_state(reading, active),
            mass_kg=mass_kg,
            load_kg=self.totals.load_kg,
            total_kg=self.totals.total_kg,
            load_number=self.totals.load_number,
            zero_mv=reading.zero.zero_mv if reading.zero else _NAN,
            pulse_mv=window.pulse_mv,
            saturated_share=window.saturated_share,
            lost_frames=window.lost_frames,
            surplus_frames=window.surplus_frames,
            repeated_frames=window.repeated_frames,
            sweep_id=self._sweep.sweep_id if sweep_step >= 0 or self._sweep.visiting else 0,
            sweep_step=sweep_step if sweep_step >= 0 else self._sweep.step,
            usable_for_calibration=sweep_step >= 0,
            parameter_version=self._estimator.parameters.version,
            faults=active,
            latitude_deg=moment.latitude_deg,
            longitude_deg=moment.longitude_deg,
            ground_speed_m_s=moment.ground_speed_m_s,
            course_deg=moment.course_deg,
        )

    def _learn(self, at_s: float, record: WindowRecord) -> None:
        """Collect a sweep's windows; at its end hand them to the calibrator and take what comes back."""
        if not self._sweep.visiting and not self._sweep.completed:
            self._sweep_records.clear()
            self._weigh(record)
            return
        if record.usable_for_calibration:
            self._sweep_records.append(record)
        if not self._sweep.completed:
            return
        records, self._sweep_records = self._sweep_records, []
        if self._sweep.lying_feedback():
            self._sweep.abort(at_s, SweepAbort.FORCE_DOES_NOT_FOLLOW)
            return
        self.disagreement.add(records, self._estimator.parameters)
        updated = False
        if self._calibrator is not None:
            self._weights_new = False
            self._outcome = self._calibrator.update(
                records, self.anchors, self._estimator, believe_sweep=not self.disagreement.present
            )
            if self._outcome.estimator is not None:
                self.set_estimator(self._outcome.estimator, 0.0)
                updated = True
        self._sweep.finish(at_s, updated)

    def _weigh(self, record: WindowRecord) -> None:
        """Hand reference masses that have come since the last lesson to the calibrator."""
        if self._calibrator is None or not self._weights_new:
            return
        self._weights_new = False
        self._outcome = self._calibrator.weigh(record, self.anchors, self._estimator)
        if self._outcome.estimator is not None:
            self.set_estimator(self._outcome.estimator, 0.0)

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


def _stale(moment: Moment) -> bool:
    """Whether there is no plate angle of late."""
    return not isfinite(moment.angle_deg)


class _Feeding:
    """Hands a run's samples, speeds and angles to the builder, up to one end of a window after another."""

    def __init__(self, builder: WindowBuilder, run: FrameRun, offset_s: float, inputs: RunInputs) -> None:
        self._builder = builder
        self.inputs = inputs
        times = run.sample_times_s + offset_s
        self._rows = np.column_stack((times, run.samples))
        speed, angle = inputs.track("speed_rad_s"), inputs.track("angle_deg")
        self._parts: list[tuple[NDArray[np.float64], Callable[[int, int], None]]] = [
            (times, self._add_rows),
            (speed.times_s, partial(self._add, builder.add_speeds, speed.times_s.tolist(), speed.values.tolist())),
            (angle.times_s, partial(self._add, builder.add_angles, angle.times_s.tolist(), (angle.values * DEGREE).tolist())),
        ]
        self._done = [0] * len(self._parts)

    def up_to(self, end_s: float) -> None:
        """All that came before end_s."""
        for index, (times, add) in enumerate(self._parts):
            last = int(np.searchsorted(times, end_s, side="left"))
            add(self._done[index], last)
            self._done[index] = last

    def rest(self) -> None:
        """All that is left."""
        self.up_to(float("inf"))

    def _add_rows(self, first: int, last: int) -> None:
        self._builder.add_block(self._rows[first:last])

    @staticmethod
    def _add(
        add: Callable[[Sequence[float], Sequence[float]], None], times: list[float], values: list[float], first: int, last: int
    ) -> None:
        add(times[first:last], values[first:last])


def _measured(flow: _Flow) -> bool:
    return isfinite(flow.rate_kg_s)


def _fits(value: float, largest: float) -> Value:
    """The value where the signal can carry it; beyond that it is not available, never cut off."""
    return value if 0.0 <= value <= largest else NOT_AVAILABLE
