"""The yield monitor: frames in, results out, time only from the frames.

The parts, each with one idea: `schedule` says when something is due, `inputs` holds the slow inputs, `impact_sensors` forms
windows, `measurement` takes the zero off and sees the harvest, `flow` judges what the estimator says, `loads` counts mass,
`plate` drives the sweep, `health` shows faults, `waveform` looks at the samples themselves, `learning` changes parameters,
`publishing` makes frames. The monitor is the order in which they work.

`feed` and `feed_run` give the same bits for the same frames, one by one or in blocks. Nothing here raises on any sequence of
frames: what cannot be used is left out, and quality and faults say so. One window ends each second,
`WindowSettings.grid_offset_s` after the full second of bus time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

import numpy as np

from yieldmon import frames as bus
from yieldmon.engine.anchors import ReferenceMass
from yieldmon.engine.clock import BusClock
from yieldmon.engine.disagreement import Disagreement
from yieldmon.engine.faults import FAULTS, FaultCode, Observation, Severity
from yieldmon.engine.flow import Circumstances, Estimate, Flow, FlowMeter, estimates
from yieldmon.engine.health import FaultBook, conditions
from yieldmon.engine.impact_sensors import ImpactSensors, RunFeeding
from yieldmon.engine.inputs import Inputs, InputSnapshot
from yieldmon.engine.learning import Learning
from yieldmon.engine.loads import LoadEvents, Loads, LoadSummary
from yieldmon.engine.measurement import Measurement, Reading
from yieldmon.engine.plate import Plate
from yieldmon.engine.publishing import Published, Publisher
from yieldmon.engine.records import CalibrationOutcome, FlowEstimator, Second, SelfCalibrator, WindowRecord, record_of
from yieldmon.engine.results import Event, PlateCommand, Result, WindowResult, ZeroTaken
from yieldmon.engine.runs import FrameRun
from yieldmon.engine.schedule import Schedule
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sources import DEFAULT_SOURCES, Sources
from yieldmon.engine.state import EngineState
from yieldmon.engine.sweep import SweepMachine, SweepWindow, support_start_s
from yieldmon.engine.totals import Totals
from yieldmon.engine.waveform import NOTHING, Waveform, WaveformReading
from yieldmon.frames import ActuatorState, Frame, OperatingState
from yieldmon.physics.machine import Machine
from yieldmon.signal_ranges import SignalRanges

__all__ = ["LoadSummary", "Monitor"]

_FORMED_TOGETHER = 16
"""Windows of a run that are formed at once: enough to share the cost of array operations, few enough for the cache."""
_ESTIMATED_TOGETHER = 64
"""The same for flow estimates."""


_KEPT_SINCE_ZERO = 7200
"""Seconds that can be measured again when a zero calibration is undone."""


class Monitor:
    """One yield monitor on one bus.

    Parameters
    ----------
    settings, machine
        Every number that the engine uses.
    estimator
        Turns force into flow.
    calibrator
        Learns from sweeps and reference masses; None: the parameters stay.
    sources
        Which message and signal brings what.
    ranges
        Of the signals that are published; None: those of the shipped DBC.

    Operator commands are plain methods; they take effect with the next window or tick.
    """

    def __init__(
        self,
        settings: EngineSettings,
        machine: Machine,
        estimator: FlowEstimator,
        calibrator: SelfCalibrator | None = None,
        *,
        sources: Sources = DEFAULT_SOURCES,
        ranges: SignalRanges | None = None,
    ) -> None:
        windows = settings.windows
        self.settings = settings
        self.machine = machine
        self.sources = sources
        self.faults = FaultBook()
        self._clock = BusClock(settings.clock)
        self._schedule = Schedule(
            window_s=windows.window_s,
            command_interval_s=settings.plate.command_interval_s,
            grid_offset_s=windows.grid_offset_s,
        )
        self._inputs = Inputs(settings.inputs, sources)
        self._sensors = ImpactSensors(windows, machine, sources, traces=settings.waveform.enabled)
        self._waveform = Waveform(settings.waveform, machine) if settings.waveform.enabled else None
        self._measurement = Measurement(settings, machine, sources)
        self._flow_meter = FlowMeter(settings, machine.sensor.gain_n_per_mv)
        self._loads = Loads(settings)
        self._plate = Plate(settings, machine)
        self._learning = Learning(settings, machine, estimator, calibrator)
        self._publisher = Publisher(windows.min_coverage, ranges)
        self._windows = 0
        self._since_zero: deque[WindowRecord] = deque(maxlen=_KEPT_SINCE_ZERO)
        self._publishing = True
        self._begun_with: LoadEvents = ()

    # Frames

    def feed(self, frame: Frame) -> list[Result]:
        """Take one frame; returns what happened, in order, usually nothing."""
        now = self._clock.engine_time(frame.time_s)
        if now is None:
            return []
        results = self._advance(now) if now >= self._schedule.next_s else []
        self._sensors.take(frame.message, now, frame.signals)
        for quantity in self._inputs.take(frame.message, now, frame.signals):
            self._sensors.add(quantity, now, self._inputs.held[quantity].value)
        return results

    def tick(self, time_s: float) -> list[Result]:
        """Bus time has come to time_s (s) without a frame of ours; returns what happened."""
        now = self._clock.engine_time(time_s)
        return [] if now is None else self._advance(now)

    def feed_run(self, run: FrameRun, *, reports: bool = True) -> list[Result]:
        """Take a run of frames: the same as `feed` frame by frame, to the bit, at a fraction of its cost.

        reports: False leaves out the frames that publish a window, which a log's reader has no use for.
        """
        if not run.times_s.size:
            return []
        self._publishing = reports
        try:
            if self._clock.now_s is None:
                start = self._clock.engine_time(float(run.times_s[0]))
                if start is not None:
                    self._advance(start)
            return self._feed_regular(run) if self._clock.regular(run.times_s) else self._feed_one_by_one(run)
        finally:
            self._publishing = True

    # Operator and service

    def start_load(self) -> LoadEvents:
        """Begin a new load."""
        return self._loads.start(self._bus_now())

    def reset_totals(self) -> LoadEvents:
        """All masses from 0, in a new load."""
        return self._loads.reset(self._bus_now())

    def stop_load(self) -> LoadEvents:
        """The load is complete; mass measured from now on belongs to no load until the next one starts."""
        return self._loads.stop(self._bus_now())

    @property
    def signs_of_grain(self) -> str:
        """What speaks against calibrating the zero now, "" where nothing does."""
        return self._measurement.signs_of_grain

    def tell_kernel_weight(self, thousand_kernel_weight_g: float) -> bool:
        """The mass of a thousand kernels of what is harvested from now on; False where the waveform is not looked at."""
        if self._waveform is None:
            return False
        self._waveform.kernel_mass_kg = 1e-6 * thousand_kernel_weight_g
        return True

    def calibrate_zero(self) -> None:
        """Zero-flow calibration: the operator vouches that the elevator runs empty for the next seconds."""
        self._since_zero.clear()
        self._measurement.zero.calibrate(against_signs=bool(self.signs_of_grain))

    def undo_zero(self) -> tuple[float, LoadEvents]:
        """The zero before the operator's last calibration again; mass that was missed since, kg, and the loads that changed.

        Raises ValueError when there is none to go back to.
        """
        zero = self._measurement.zero
        known = zero.before
        if known is None:
            raise ValueError("there is no zero calibration by an operator since the start that could be undone")
        found = self._missed(known.zero_mv)
        self._since_zero.clear()
        zero.undo()
        return sum(found.values()), self._loads.correct(found)

    def _missed(self, zero_mv: float) -> dict[int, float]:
        """Load number -> kg that its seconds since the operator's zero calibration miss where this is the zero."""
        gain = self.machine.sensor.gain_n_per_mv
        rows = [r for r in self._since_zero if isfinite(r.zero_mv) and isfinite(r.force_n) and r.coverage > 0.0]
        force = np.array([r.force_n + (r.zero_mv - zero_mv) * gain for r in rows])
        loaded = force > self.settings.gate.grain_on_n
        rows, force = [r for r, ok in zip(rows, loaded, strict=True) if ok], force[loaded]
        if not rows:
            return {}
        columns = np.array([(r.plate_angle_rad, r.elevator_speed_rad_s, r.force_std_dev_n, r.moisture_pct) for r in rows]).T
        flow = np.nan_to_num(self.estimator.estimate(force, *columns).mass_flow_kg_s)
        missed: dict[int, float] = {}
        for row, rate in zip(rows, flow.tolist(), strict=True):
            missed[row.load_number] = missed.get(row.load_number, 0.0) + rate * row.duration_s - row.mass_kg
        return missed

    def request_sweep(self) -> None:
        """Sweep as soon as the conditions hold."""
        self.sweep.request()

    def abort_sweep(self) -> None:
        """End a sweep and take the plate home."""
        self.sweep.abort(self._clock.now_s or 0.0)

    def set_estimator(self, estimator: FlowEstimator, calibration_age_s: float | None) -> None:
        """Other parameters; calibration_age_s: time since they were calibrated, None where it is not known."""
        self._learning.use(estimator, calibration_age_s)

    def ticket(self, load_number: int, mass_kg: float, std_dev_kg: float) -> ReferenceMass:
        """A scale ticket for a load; returns the reference mass, which teaches when the window or sweep under way ends.

        Raises ValueError when the load is not known or a number makes no sense.
        """
        return self._learning.ticket(load_number, mass_kg, std_dev_kg, self.loads, self._bus_now())

    def report_fault(self, code: FaultCode, present: bool, detail: str = "") -> None:
        """A condition that the service sees (bus error, store failing, output conflict, ...); holds until reported gone."""
        self.faults.report(code, present, detail)

    # What there is to see

    @property
    def totals(self) -> Totals:
        """Mass measured so far."""
        return self._loads.totals

    @property
    def loads(self) -> tuple[LoadSummary, ...]:
        """Loads completed since the start, and the open one."""
        return self._loads.all

    @property
    def open_load(self) -> LoadSummary | None:
        """The load that is open."""
        return self._loads.open

    @property
    def estimator(self) -> FlowEstimator:
        """The estimator in use."""
        return self._learning.estimator

    @property
    def outcome(self) -> CalibrationOutcome | None:
        """What the last whole sweep or weighed mass taught."""
        return self._learning.outcome

    @property
    def disagreement(self) -> Disagreement:
        """Whether the model disagrees with the sweeps."""
        return self._learning.disagreement

    @property
    def anchors(self) -> tuple[ReferenceMass, ...]:
        """Reference masses kept, by time."""
        return self._learning.anchors

    @property
    def sweep(self) -> SweepMachine:
        """The sweep, to look at."""
        return self._plate.sweep

    @property
    def due_s(self) -> float:
        """Bus time of the first frame that will make `feed` do more than take note of it; -inf before the first frame."""
        return self._clock.bus_time(self._schedule.next_s)

    def snapshot(self) -> EngineState:
        """What is to outlive a restart."""
        learning, totals = self._learning, self.totals
        calibrator = learning.calibrator
        return EngineState(
            totals=totals,
            zero=self._measurement.zero.state,
            windows=self._windows,
            sweep_id=self.sweep.sweep_id,
            sweep_due_in_s=self.sweep.remaining_s(self._clock.now_s or 0.0),
            calibration_age_s=learning.calibration_age_s,
            parameter_version=learning.estimator.parameters.version,
            disagreement=learning.disagreement.state,
            calibrator=calibrator.snapshot(self._bus_now(), totals.total_kg) if calibrator is not None else None,
        )

    def restore(self, state: EngineState) -> None:
        """Go on from a snapshot; to be called before the first frame."""
        self._loads.restore(state.totals)
        self._measurement.zero.state = state.zero
        self._windows = state.windows
        self._plate.restore(state.sweep_id, state.sweep_due_in_s, self.settings.sweep.first_after_s)
        learning, parameters = self._learning, self.estimator.parameters
        learning.calibration_age_s = state.calibration_age_s
        # Where other parameters came from outside meanwhile, the patterns seen so far say nothing about them.
        if state.parameter_version == parameters.version:
            learning.disagreement.restore(state.disagreement, parameters)
            if state.calibrator is not None and learning.calibrator is not None:
                learning.calibrator.restore(state.calibrator, parameters, state.totals.total_kg)

    # Time

    def _advance(self, now: float) -> list[Result]:
        """Do all that falls due up to now, in order of time."""
        schedule = self._schedule
        if not schedule.begun:
            schedule.begin(now)
            self._begun_with = self._loads.begin(self._bus_now())
        results: list[Result] = []
        while schedule.next_s <= now:
            held = self._inputs.snapshot(schedule.next_s)
            if schedule.window_is_due:
                results += self._close_windows([held])
            else:
                results += self._due(held.angle_deg, self._inputs.actuator)
        return results

    def _due(self, angle_deg: float, actuator: ActuatorState) -> list[Result]:
        """The tick that is due, the plate being at angle_deg (nan: unknown)."""
        at_s = self._schedule.next_s
        signals = self._plate.tick(at_s, angle_deg, actuator)
        self._schedule.done(driving=self.sweep.driving)
        if signals is None:
            return []
        frame = Frame(self._clock.bus_time(at_s), bus.PLATE_ACTUATOR_COMMAND, signals)
        return [PlateCommand((frame,), self._plate.ended(self._learning.lesson, self.estimator.parameters.version))]

    def _bus_now(self) -> float:
        return float("nan") if self._clock.now_s is None else self._clock.bus_time(self._clock.now_s)

    # Runs

    def _feed_one_by_one(self, run: FrameRun) -> list[Result]:
        frames = {place: frame for part in run.others for place, frame in part.frames()}
        rows = {
            place: (sensor, row)
            for sensor, part in enumerate(run.samples)
            for place, row in zip(part.places.tolist(), part.rows.tolist(), strict=True)
        }
        results: list[Result] = []
        for place, time_s in enumerate(run.times_s.tolist()):
            frame = frames.get(place)
            if place not in rows:
                results += self.feed(frame) if frame is not None else self.tick(time_s)
                continue
            now = self._clock.engine_time(time_s)
            if now is not None:
                results += self._advance(now) if now >= self._schedule.next_s else []
                sensor, row = rows[place]
                self._sensors.take_row(sensor, now, row)
                if frame is not None:
                    for quantity in self._inputs.take(frame.message, now, frame.signals):
                        self._sensors.add(quantity, now, self._inputs.held[quantity].value)
        return results

    def _feed_regular(self, run: FrameRun) -> list[Result]:
        """A run whose times neither step back nor jump: its windows are closed a group at a time."""
        offset_s = self._clock.offset_s
        last_s = float(run.times_s[-1]) + offset_s
        inputs = self._inputs.follow(run, offset_s)
        feeding = self._sensors.feeding(run, offset_s, inputs)
        ends = self._schedule.window_ends(last_s)
        held = inputs.snapshots(ends)
        results: list[Result] = []
        first = 0
        while first < len(ends):
            last = first + 1
            if not held[first].angle_stale:
                while last < min(len(ends), first + _ESTIMATED_TOGETHER) and not held[last].angle_stale:
                    last += 1
            results += self._close_windows(held[first:last], feeding)
            first = last
        feeding.rest()
        while self._schedule.next_s <= last_s:
            results += self._due(*inputs.plate_at(self._schedule.next_s))
        inputs.finish()
        self._clock.now_s = last_s
        return results

    # Windows

    def _close_windows(self, held: Sequence[InputSnapshot], feeding: RunFeeding | None = None) -> list[Result]:
        """Close the windows at whose ends these inputs are held, one after the other.

        What a window is worth is worked out for all of them together, in three passes: zero, gate and force, each after the one
        before; the estimates, which know nothing of each other; all the rest, in order again. feeding: what comes before their
        ends and is not with the sensors yet. Where the angle is stale at an end, that window comes alone.
        """
        results: list[Result] = []
        first = held[0]
        if feeding is not None:
            results += self._ticks_before(first.time_s, feeding)
        if first.angle_stale and (first.actuator == ActuatorState.MOVING or self._plate.driving):
            if feeding is not None:
                feeding.up_to(first.time_s)
            self._sensors.forget_angle()
        readings: list[Reading] = []
        for start in range(0, len(held), _FORMED_TOGETHER):
            readings += self._read(held[start : start + _FORMED_TOGETHER], feeding)
        estimator, found = self.estimator, estimates(self.estimator, readings)
        for index, reading in enumerate(readings):
            if self.estimator is not estimator:
                estimator = self.estimator
                found[index:] = estimates(estimator, readings[index:])
            if feeding is not None:
                results += self._ticks_before(reading.window.end_s, feeding)
            results.append(self._conclude(reading, found[index]))
            results += self._due(reading.inputs.angle_deg, ActuatorState(reading.inputs.actuator))
        return results

    def _ticks_before(self, end_s: float, feeding: RunFeeding) -> list[Result]:
        results: list[Result] = []
        while self._schedule.next_s < end_s:
            results += self._due(*feeding.inputs.plate_at(self._schedule.next_s))
        return results

    def _read(self, held: Sequence[InputSnapshot], feeding: RunFeeding | None) -> list[Reading]:
        """Form the windows that end where these inputs are held, and read them."""
        if feeding is not None:
            feeding.up_to(held[-1].time_s)
        windows = self._sensors.close_run([self._schedule.window_start_s, *(inputs.time_s for inputs in held)])
        self._schedule.window_start_s = held[-1].time_s
        jumps = self._clock.jumps
        return [self._measurement.read(window, inputs, jumps) for window, inputs in zip(windows, held, strict=True)]

    def _conclude(self, reading: Reading, estimate: Estimate | None) -> WindowResult:
        """All that follows from a window's flow: totals, sweep, faults, the record, what is learnt, the frames."""
        window, learning = reading.window, self._learning
        self._windows += 1
        learning.grow_older(window.end_s - window.start_s)
        circumstances = Circumstances(self.sweep.visiting, self.faults.is_active(FaultCode.CALIBRATION_OLD))
        flow = self._flow_meter.flow(reading, estimate, self.estimator, circumstances)
        seen = self._seen(reading, flow)
        if self.settings.waveform.combine and seen.combined_kg_s > 0.0:
            flow = replace(flow, rate_kg_s=seen.combined_kg_s, std_dev_kg_s=seen.combined_std_dev_kg_s)
        mass_kg = self._loads.count(window, flow, reading.inputs.fresh["moisture"])
        learning.weighed(window, reading.inputs, flow, self.totals.total_kg - mass_kg, mass_kg)
        step = self.sweep.window(self._sweep_window(reading, flow))
        bus_s = self._clock.bus_time(window.end_s)
        shown = self.faults.observe_all(conditions(self._observation(reading, flow, seen)), bus_s)
        published = self._flow_meter.published(flow, plate_rests_at_home=reading.still and reading.at_home)
        record = self._record(bus_s, reading, published, mass_kg, step, seen)
        if self._measurement.zero.before is not None:
            self._since_zero.append(record)
        learnt = learning.learn(window.end_s, record, self.sweep)
        ended = self._plate.ended(learning.lesson, self.estimator.parameters.version)
        zero: tuple[Event, ...] = (ZeroTaken(bus_s, record.zero_mv),) if reading.zero_taken else ()
        begun, self._begun_with = self._begun_with, ()
        frames = self._publisher.frames(record, self._published()) if self._publishing else ()
        return WindowResult(record, frames, (*begun, *zero, *shown, *learnt, *ended))

    def _seen(self, reading: Reading, flow: Flow) -> WaveformReading:
        if self._waveform is None:
            return NOTHING
        return self._waveform.see(reading, flow.rate_kg_s, flow.std_dev_kg_s, self.estimator)

    def _observation(self, reading: Reading, flow: Flow, seen: WaveformReading) -> Observation:
        learning = self._learning
        return Observation(
            reading, flow, self.sweep, learning.outcome, learning.disagreement, learning.calibration_age_s, self.settings, seen
        )

    def _published(self) -> Published:
        return Published(self.sweep, self.estimator.parameters, self._learning.calibration_age_s, self.faults)

    def _sweep_window(self, reading: Reading, flow: Flow) -> SweepWindow:
        window, settings = reading.window, self.settings.windows
        whole = window.coverage >= settings.full_coverage and not flow.saturated and window.lost_frames == 0
        return SweepWindow.of(
            window, support_start_s(window, self.machine, settings.max_ramp_s), flow.rate_kg_s, flow.force_n, whole, reading.still
        )

    def _record(
        self, bus_s: float, reading: Reading, flow: Flow, mass_kg: float, sweep_step: int, seen: WaveformReading
    ) -> WindowRecord:
        active, sweep, counts = self.faults.active, self.sweep, sweep_step >= 0
        return record_of(
            Second(
                bus_s=bus_s,
                number=self._windows,
                reading=reading,
                flow=flow,
                mass_kg=mass_kg,
                totals=self.totals,
                operating_state=self._operating_state(reading, active),
                faults=active,
                sweep_id=sweep.sweep_id if counts or sweep.visiting else 0,
                sweep_step=sweep_step if counts else sweep.step,
                usable_for_calibration=counts,
                parameter_version=self.estimator.parameters.version,
                waveform=seen,
            )
        )

    def _operating_state(self, reading: Reading, active: tuple[FaultCode, ...]) -> OperatingState:
        if any(FAULTS[code].severity is Severity.STOP_TRUSTING for code in active):
            return OperatingState.FAULT
        if not reading.window.samples or not reading.speed_known:
            return OperatingState.STARTING
        if reading.zero is None or reading.calibrating_zero:
            return OperatingState.ZEROING
        if self.sweep.driving:
            return OperatingState.SWEEPING
        return OperatingState.HARVESTING if reading.harvesting else OperatingState.NOT_HARVESTING
