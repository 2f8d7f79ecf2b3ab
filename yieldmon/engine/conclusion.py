"""The results of a window, from its reading and flow: mass, sweep, faults, record, updates of the parameters, frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite, nan
from typing import NamedTuple

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.faults import FAULTS, FaultCode, Observation, Severity
from yieldmon.engine.flow import Circumstances, Estimate, Flow, away_from_home
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.health import conditions
from yieldmon.engine.mass.budget import EMPTY, MassBudget
from yieldmon.engine.mass.load_summary import LoadEvents
from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.mass.silences import Missing
from yieldmon.engine.measurement import Reading
from yieldmon.engine.parts import Parts
from yieldmon.engine.publishing import Published
from yieldmon.engine.records import Second, WindowRecord, record_of
from yieldmon.engine.results import Event, Result, WindowResult, ZeroTaken
from yieldmon.engine.sampling.since_zero import KeptSecond
from yieldmon.engine.self_calibration.load_forces import WindowForces
from yieldmon.engine.self_calibration.parameter_updater import ParametersChanged
from yieldmon.engine.self_calibration.scale_alarm import ScaleCheck
from yieldmon.engine.sweeps.sweep_inputs import SweepWindow, support_start_s
from yieldmon.engine.waveform.deferred_waveform import DeferredWaveform
from yieldmon.engine.waveform.waveform_reading import NOTHING
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.self_calibration.angle_error import AngleError
from yieldmon.frames import OperatingState

_result = maker_of(WindowResult)


class _Measured(NamedTuple):
    """Flow, mass and area of a window. by_mean_force: by the mean force alone; flow: corrected by sweeps and waveform."""

    by_mean_force: Flow
    flow: Flow
    mass_kg: float
    area_m2: float


class Conclusion:
    """Concludes windows in order, and counts them.

    Attributes
    ----------
    windows : int
        Windows concluded so far.
    publishing : bool
        Whether to make the frames that publish a window.
    begun_with : tuple of LoadOpened
        Loads that began before the first window; they are returned with it.
    """

    def __init__(self, parts: Parts, *, waveform_later: bool) -> None:
        self._parts = parts
        self._deferred = None if parts.waveform is None else DeferredWaveform(parts.waveform)
        self._waveform_later = waveform_later
        self.windows = 0
        self.publishing = True
        self._zero_mv = nan
        """Zero with which the next window is measured; nan until it is known."""
        self._counted_kg: deque[float] = deque(maxlen=parts.settings.zero.settle_windows + parts.settings.gate.off_windows)
        """Masses of the newest seconds, in which an elevator that looks empty may still have counted as harvesting."""
        self._far = False
        """Whether the empty plate reads too far from the zero for the zero to follow."""
        self.begun_with: LoadEvents = ()

    def restore(self, windows: int) -> None:
        """Continue counting after this many windows."""
        self.windows = windows

    def conclude(self, reading: Reading, estimate: Estimate | None) -> WindowResult:
        """The window's result. estimate: None where there is no flow."""
        parts, window = self._parts, reading.window
        if self._deferred is not None:
            self._deferred.evaluate()
        updater, loads, sweep, bus_s = parts.updater, parts.loads, parts.plate.sweep, parts.clock.bus_time(window.end_s)
        self.windows += 1
        updater.add_age(window.end_s - window.start_s)
        estimator = updater.estimator
        measured = self._measured(reading, estimate, estimator)
        # By mean force alone: a correction found by sweeps must not end a sweep.
        step = sweep.window(self._sweep_window(reading, measured.by_mean_force))
        shown = parts.faults.observe_all(conditions(self._observation(reading, measured.flow)), bus_s)
        second = self._second(bus_s, reading, measured, step)
        record = record_of(second)
        self._keep_since_zero(record)
        restated = self._seen_empty(reading)
        changes = self._update_parameters(window.end_s, record, estimator)
        ended = parts.plate.ended(updater.last_update, updater.estimator.parameters.version)
        zero: tuple[Event, ...] = (ZeroTaken(bus_s, record.zero_mv),) if reading.zero_taken else ()
        begun, self.begun_with = self.begun_with, ()
        frames = parts.publisher.frames(record, self._published()) if self.publishing else ()
        emptied = parts.unloading.emptied(reading.inputs, window.end_s - window.start_s) and loads.totals.load_kg > 0.0
        started = loads.start(bus_s) if emptied else ()
        result: WindowResult = _result(record, frames, (*begun, *zero, *shown, *restated, *changes, *ended, *started), NOTHING)
        if self._deferred is None:
            return result
        self._deferred.add(second, measured.by_mean_force, estimator)
        return result if self._waveform_later else self._deferred.complete(result)

    def completed(self, results: Sequence[Result]) -> list[Result]:
        """The results last returned, with their windows' waveform; see `Monitor.completed`."""
        return list(results) if self._deferred is None else self._deferred.completed(results)

    def _measured(self, reading: Reading, estimate: Estimate | None, estimator: FlowEstimator) -> _Measured:
        """Flow, mass and area of the window; adds the mass to its load and to the totals."""
        parts, window = self._parts, reading.window
        updater, loads = parts.updater, parts.loads
        by_mean_force = self._by_mean_force(reading, estimate, estimator)
        flow = self._corrected(away_from_home(by_mean_force, reading, updater.model_error), window.end_s, estimator)
        area_m2 = parts.area.second(window.end_s, window.weight_s, reading.inputs, grain_comes=flow.measured)
        missing = Missing.of(
            sampled=window.samples > 0,
            speed=reading.speed_rad_s,
            in_range=reading.in_range,
            zeroed=reading.zero is not None,
        )
        if not flow.measured and parts.measurement.hides_grain(reading.force_n):
            missing = Missing.HIDDEN
        silent = window.samples == 0 and not reading.speed_known
        mass_kg = loads.count(window, flow, reading.inputs.fresh["moisture"], area_m2, missing, silent=silent)
        self._weigh(reading, flow, mass_kg)
        angle_rad = window.plate_angle_rad if isfinite(window.plate_angle_rad) else parts.machine.home_plate_angle_rad
        loads.share(mass_kg, flow, estimator.parameters.version, angle_rad, updater.load_error)
        return _Measured(by_mean_force, flow, mass_kg, area_m2)

    def _seen_empty(self, reading: Reading) -> LoadEvents:
        """The loads whose standard deviation grows because the plate is seen empty, away from the zero."""
        if not isfinite(reading.zero_moved_mv):
            return ()
        return self._parts.loads.seen_empty(reading.zero_moved_mv * self._parts.machine.sensor.gain_n_per_mv)

    def _keep_since_zero(self, record: WindowRecord) -> None:
        """Keep the second for an undo of the operator's zero, where there is one."""
        if self._parts.measurement.zero.before is not None:
            kept = KeptSecond.of(record)
            zero_mv = self._zero_mv if isfinite(self._zero_mv) else kept.zero_mv
            number = kept.load_number if self._parts.loads.totals.load_open else NO_LOAD
            self._parts.since_zero.add((replace(kept, zero_mv=zero_mv, load_number=number),))
        self._zero_mv = record.zero_mv

    def _update_parameters(self, end_s: float, record: WindowRecord, estimator: FlowEstimator) -> tuple[Event, ...]:
        """Updates of the parameters with this window, and the loads whose standard deviation they change."""
        parts, updater, sweep = self._parts, self._parts.updater, self._parts.plate.sweep
        waveform, before = parts.waveform, (updater.load_error, updater.scale_alarm.state.contradiction)
        channels = None
        if waveform is not None and parts.settings.sweep.when == "information":
            channels = waveform.channels(end_s, estimator)
        changes = updater.update(end_s, record, sweep, channels)
        restated = self._restate(*before, changes)
        self._hold_moisture(changes)
        if waveform is not None and not (sweep.driving or changes):
            measurement = waveform.kernel_measurements.take()
            changes = updater.update_from_kernels(measurement, record) if measurement is not None else ()
        return (*changes, *restated)

    def _by_mean_force(self, reading: Reading, estimate: Estimate | None, estimator: FlowEstimator) -> Flow:
        parts = self._parts
        old = parts.faults.is_active(FaultCode.CALIBRATION_OLD)
        sweep, updater = parts.plate.sweep, parts.updater
        doubted = sweep.not_following and sweep.abort_reason is not None
        circumstances = Circumstances(sweep.visiting, old, updater.load_error, updater.drift_sd, doubted)
        return parts.flow_meter.flow(reading, estimate, estimator, circumstances)

    def _corrected(self, by_mean_force: Flow, end_s: float, estimator: FlowEstimator) -> Flow:
        """The flow with the scale that the waveform of earlier windows has shown, where `waveform.combine` is set."""
        waveform = self._parts.waveform
        if waveform is None or not self._parts.settings.waveform.combine:
            return by_mean_force
        found = waveform.corrected(by_mean_force, end_s, estimator)
        return by_mean_force if found is None else replace(by_mean_force, rate_kg_s=found[0], std_dev_kg_s=found[1])

    def _weigh(self, reading: Reading, flow: Flow, mass_kg: float) -> None:
        """Compare the window's mass with the tank scale, whose mass replaces the measured one while the zero is suspect."""
        loads, updater, doubted = self._parts.loads, self._parts.updater, self._parts.measurement.zero.suspect
        totals = loads.totals
        if reading.windows_since_jump == 0 and reading.window.lost_frames:
            # No clock was set: frames went on meanwhile.
            loads.doubt()
            updater.masses.frames_missed()
        self._counted_kg.append(mass_kg)
        if reading.zero_far_mv and not self._far:
            # All of these seconds looked empty.
            loads.widen(sum(self._counted_kg))
        self._far = reading.zero_far_mv != 0.0
        forces = _forces(reading, flow, mass_kg) if mass_kg > 0.0 else None
        missed_kg = updater.masses.match_tank_scale(
            reading.window,
            reading.inputs,
            flow,
            totals.total_kg - mass_kg,
            mass_kg,
            totals.total_budget,
            forces=forces,
            zero_doubted=doubted,
        )
        if doubted:
            loads.doubt()
        elif reading.zero_taken:
            updater.masses.empty_since(self._parts.measurement.zero.taken_from_s)
        if missed_kg > 0.0:
            number = totals.load_number if totals.load_open else NO_LOAD
            self._parts.since_zero.add_scale(number, missed_kg)
            by_scale = MassBudget(noise_kg2=2.0 * self._parts.settings.reference_masses.scale_std_dev_kg**2)
            loads.correct({number: MissedMass(budget=EMPTY).plus(missed_kg, None, area_known=True, budget=by_scale)})
        if totals.load_open and forces is not None:
            updater.masses.tickets.measured(totals.load_number, mass_kg, forces)

    def _restate(
        self, model_error: AngleError, contradiction: ScaleCheck | None, changes: Sequence[ParametersChanged]
    ) -> LoadEvents:
        """Restate the standard deviations of loads by what sweeps and weighed masses have just shown.

        model_error, contradiction: before this window. A contradicting mass that is itself doubted does not change closed loads.
        """
        loads, updater = self._parts.loads, self._parts.updater
        error, found = updater.load_error, updater.scale_alarm.state.contradiction
        restated = loads.restate(error, updater.estimator.parameters.version) if error != model_error else ()
        if found is not None and found is not contradiction:
            relative, by_load = abs(found.weighed_kg / found.measured_kg - 1.0), updater.masses.load_of(found)
            if changes or updater.calibrator is None:
                restated = (*restated, *loads.scale_is_off(relative, by_load))
            else:
                loads.widen(relative * loads.totals.load_kg, by_load)
        if weighed := [change for change in changes if change.origin == ParameterOrigin.TICKET]:
            loads.scale_is_set([number for change in weighed for number, _ in change.references])
        return restated

    def _hold_moisture(self, changes: Sequence[ParametersChanged]) -> None:
        """Note the moisture for which changed parameters hold; where it is not known, that of the parameters before."""
        for change in changes:
            if change.moisture_pct is not None:
                self._parts.flow_meter.moisture.hold(change.parameters.version, change.moisture_pct)

    def _observation(self, reading: Reading, flow: Flow) -> Observation:
        parts, updater = self._parts, self._parts.updater
        seen = parts.waveform.last if parts.waveform is not None else NOTHING
        return Observation(
            reading=reading,
            flow=flow,
            sweep=parts.plate.sweep,
            outcome=updater.outcome,
            disagreement=updater.disagreement,
            calibration_age_s=updater.calibration_age_s,
            settings=parts.settings,
            waveform=seen,
            mass_near_end=parts.publisher.mass_near_end(parts.loads.totals, parts.settings.faults.mass_near_end),
            scale_alarm=updater.scale_alarm.detail,
        )

    def _published(self) -> Published:
        parts, updater = self._parts, self._parts.updater
        return Published(parts.plate.sweep, updater.estimator.parameters, updater.calibration_age_s, parts.faults)

    def _sweep_window(self, reading: Reading, flow: Flow) -> SweepWindow:
        window, settings = reading.window, self._parts.settings.windows
        whole = window.coverage >= settings.full_coverage and not flow.saturated and window.lost_frames == 0
        whole = whole and not window.contested
        support_s = support_start_s(window, self._parts.machine, settings.max_ramp_s)
        return SweepWindow.of(window, support_s, flow.rate_kg_s, flow.force_n, whole, reading.still)

    def _second(self, bus_s: float, reading: Reading, measured: _Measured, sweep_step: int) -> Second:
        """Everything known of a window except its waveform."""
        parts, counts = self._parts, sweep_step >= 0
        active, sweep = parts.faults.active, parts.plate.sweep
        return Second(
            bus_s=bus_s,
            number=self.windows,
            reading=reading,
            flow=parts.flow_meter.published(
                measured.flow, coverage=reading.window.coverage, plate_rests_at_home=reading.still and reading.at_home
            ),
            mass_kg=measured.mass_kg,
            area_m2=measured.area_m2,
            totals=parts.loads.totals,
            operating_state=_operating_state(reading, active, sweeping=sweep.driving),
            faults=active,
            sweep_id=sweep.sweep_id if counts or sweep.visiting else 0,
            sweep_step=sweep_step if counts else sweep.step,
            usable_for_calibration=counts,
            parameter_version=parts.updater.estimator.parameters.version,
            waveform=NOTHING,
        )


def _forces(reading: Reading, flow: Flow, mass_kg: float) -> WindowForces:
    window, moisture_pct = reading.window, reading.inputs.fresh["moisture"]
    return WindowForces(mass_kg / flow.rate_kg_s, flow.force_n, window.plate_angle_rad, window.speed_rad_s, moisture_pct)


def _operating_state(reading: Reading, active: tuple[FaultCode, ...], *, sweeping: bool) -> OperatingState:
    if any(FAULTS[code].severity is Severity.STOP_TRUSTING for code in active):
        return OperatingState.FAULT
    if reading.zero is None or reading.calibrating_zero:
        return OperatingState.ZEROING
    if sweeping:
        return OperatingState.SWEEPING
    return OperatingState.HARVESTING if reading.harvesting else OperatingState.NOT_HARVESTING
