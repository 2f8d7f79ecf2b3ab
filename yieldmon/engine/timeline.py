"""Frames and time in, results out, in order of time: windows and plate commands that are due are handled before later frames.

Frames one by one and runs of frames give bit-identical results; runs close their windows in groups.
"""

from __future__ import annotations

from collections.abc import Sequence

from yieldmon import frames as bus
from yieldmon.engine.conclusion import Conclusion
from yieldmon.engine.flow import Estimate, estimates
from yieldmon.engine.inputs import InputSnapshot
from yieldmon.engine.measurement import Reading
from yieldmon.engine.parts import Parts
from yieldmon.engine.results import PlateCommand, Result
from yieldmon.engine.runs import FrameRun
from yieldmon.engine.sampling.impact_sensors import RunFeeding
from yieldmon.frames import ActuatorState, Frame

_FORMED_TOGETHER = 64
"""Most windows of a run formed in one call: enough to amortise array operations, few enough for the cache."""
_READ_TOGETHER = 512
"""Most windows of a run that are read before the first of them is concluded."""
_ESTIMATED_TOGETHER = 256
"""Most flow estimates made in one call. It ends where a weighed mass may come; estimates after an update are made anew."""


class Timeline:
    """Runs the parts in order of time."""

    def __init__(self, parts: Parts, *, waveform_later: bool) -> None:
        self._parts = parts
        self.conclusion = Conclusion(parts, waveform_later=waveform_later)

    def take(self, frame: Frame) -> list[Result]:
        """One frame; see `Monitor.feed`."""
        parts = self._parts
        now = self._engine_time(frame.time_s)
        if now is None:
            return []
        results = self.advance(now) if now >= parts.schedule.next_s else []
        parts.sensors.take(frame.message, now, frame.signals)
        self._take_inputs(frame, now)
        return results

    def tick(self, time_s: float) -> list[Result]:
        """Bus time without a frame; see `Monitor.tick`."""
        now = self._engine_time(time_s)
        return [] if now is None else self.advance(now)

    def begin_log(self) -> None:
        """See `Monitor.begin_log`."""
        self._parts.clock.begin_log()

    def _engine_time(self, time_s: float) -> float | None:
        clock = self._parts.clock
        now = clock.engine_time(time_s)
        if now is not None and clock.paused_s > 0.0:
            self._parts.sensors.resume()
            self._parts.measurement.resume(now, clock.paused_s)
            clock.paused_s = 0.0
        return now

    def _take_inputs(self, frame: Frame, now: float) -> None:
        inputs = self._parts.inputs
        for quantity in inputs.take(frame.message, now, frame.signals):
            self._parts.sensors.add(quantity, now, inputs.held[quantity].value)

    def take_run(self, run: FrameRun, *, publishing: bool) -> list[Result]:
        """A run of frames; see `Monitor.feed_run`."""
        if not run.times_s.size:
            return []
        clock = self._parts.clock
        self.conclusion.publishing = publishing
        try:
            if clock.now_s is None:
                start = clock.engine_time(float(run.times_s[0]))
                if start is not None:
                    self.advance(start)
            return self._regular(run) if clock.regular(run.times_s) else self._one_by_one(run)
        finally:
            self.conclusion.publishing = True

    def _one_by_one(self, run: FrameRun) -> list[Result]:
        """A run frame by frame, for times that step or jump."""
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
                results += self.take(frame) if frame is not None else self.tick(time_s)
                continue
            now = self._engine_time(time_s)
            if now is not None:
                results += self.advance(now) if now >= self._parts.schedule.next_s else []
                sensor, row = rows[place]
                self._parts.sensors.take_row(sensor, now, row)
                if frame is not None:
                    self._take_inputs(frame, now)
        return results

    def _regular(self, run: FrameRun) -> list[Result]:
        """A run whose times neither step back nor jump; its windows are closed in groups."""
        offset_s = self._parts.clock.offset_s
        last_s = float(run.times_s[-1]) + offset_s
        inputs = self._parts.inputs.follow(run, offset_s)
        feeding = self._parts.sensors.feeding(run, offset_s, inputs)
        ends = self._parts.schedule.window_ends(last_s)
        held = inputs.snapshots(ends)
        results: list[Result] = []
        first = 0
        while first < len(ends):
            last = first + 1
            if not held[first].angle_stale:
                while last < min(len(ends), first + _READ_TOGETHER) and not held[last].angle_stale:
                    last += 1
            results += self._close_windows(held[first:last], feeding)
            first = last
        feeding.rest()
        while self._parts.schedule.next_s <= last_s:
            results += self._due(*inputs.plate_at(self._parts.schedule.next_s))
        inputs.finish()
        self._parts.clock.passed(last_s)
        return results

    def advance(self, now: float) -> list[Result]:
        """Handle everything due up to engine time now, in order."""
        schedule = self._parts.schedule
        if not schedule.begun:
            schedule.begin(now)
            self.conclusion.begun_with = self._parts.loads.begin(self._parts.bus_now)
        results: list[Result] = []
        while schedule.next_s <= now:
            held = self._parts.inputs.snapshot(schedule.next_s)
            if schedule.window_is_due:
                results += self._close_windows([held])
            else:
                results += self._due(held.angle_deg, self._parts.inputs.actuator)
        return results

    def _due(self, angle_deg: float, actuator: ActuatorState) -> list[Result]:
        """Handle the tick that is due. angle_deg: of the plate, nan where unknown."""
        at_s = self._parts.schedule.next_s
        signals = self._parts.plate.tick(at_s, angle_deg, actuator)
        self._parts.schedule.done(driving=self._parts.plate.sweep.driving)
        if signals is None:
            return []
        updater = self._parts.updater
        frame = Frame(self._parts.clock.bus_time(at_s), bus.PLATE_ACTUATOR_COMMAND, signals)
        return [PlateCommand((frame,), self._parts.plate.ended(updater.last_update, updater.estimator.parameters.version))]

    def _close_windows(self, held: Sequence[InputSnapshot], feeding: RunFeeding | None = None) -> list[Result]:
        """Close consecutive windows. held: the inputs at the windows' ends; a window whose angle is stale at its end comes alone.

        Three passes: zero, gate and force, window by window; the independent flow estimates, together; all else, window by
        window. feeding: samples of a run that the sensors have not been given yet.
        """
        results: list[Result] = []
        first = held[0]
        if feeding is not None:
            results += self._ticks_before(first.time_s, feeding)
        if first.angle_stale and (first.actuator == ActuatorState.MOVING or self._parts.plate.driving):
            if feeding is not None:
                feeding.up_to(first.time_s)
            self._parts.sensors.forget_angle()
        readings: list[Reading] = []
        for start in range(0, len(held), _FORMED_TOGETHER):
            readings += self._read(held[start : start + _FORMED_TOGETHER], feeding)
        updater = self._parts.updater
        estimator, found = updater.estimator, list[Estimate | None]()
        for index, reading in enumerate(readings):
            if index == len(found) or updater.estimator is not estimator:
                estimator = updater.estimator
                ahead = readings[index : index + _ESTIMATED_TOGETHER]
                weighed = updater.masses.next_weighed(reading.inputs for reading in ahead)
                found[index:] = self._estimated(ahead[:weighed] if weighed else ahead)
            if feeding is not None:
                results += self._ticks_before(reading.window.end_s, feeding)
            results.append(self.conclusion.conclude(reading, found[index]))
            results += self._due(reading.inputs.angle_deg, ActuatorState(reading.inputs.actuator))
        return results

    def _estimated(self, readings: Sequence[Reading]) -> list[Estimate | None]:
        """The flow estimates of these windows; where the waveform is on, the pulses of several windows are fitted together."""
        estimator, waveform = self._parts.updater.estimator, self._parts.waveform
        found = estimates(estimator, readings)
        if waveform is not None and len(readings) > 1:
            waveform.prepare(readings, [item.rate_kg_s if item is not None else float("nan") for item in found], estimator)
        return found

    def _ticks_before(self, end_s: float, feeding: RunFeeding) -> list[Result]:
        results: list[Result] = []
        while self._parts.schedule.next_s < end_s:
            results += self._due(*feeding.inputs.plate_at(self._parts.schedule.next_s))
        return results

    def _read(self, held: Sequence[InputSnapshot], feeding: RunFeeding | None) -> list[Reading]:
        """Form the windows that end where these inputs are held, and read them."""
        if feeding is not None:
            feeding.up_to(held[-1].time_s)
        windows = self._parts.sensors.close_run([self._parts.schedule.window_start_s, *(inputs.time_s for inputs in held)])
        self._parts.schedule.formed(held[-1].time_s)
        jumps = self._parts.clock.jumps
        readings = [self._parts.measurement.read(window, inputs, jumps) for window, inputs in zip(windows, held, strict=True)]
        return self._parts.uneven.evened(readings)
