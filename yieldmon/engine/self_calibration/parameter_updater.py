"""The parameters in use, and their updates: sweeps, reference masses, kernel noise and drift in, other parameters out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import nan

import numpy as np

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome, CalibrationStep, SelfCalibrator
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, Weighing
from yieldmon.engine.self_calibration.reference_masses import ReferenceMasses
from yieldmon.engine.self_calibration.scale_alarm import ScaleAlarm, name_of
from yieldmon.engine.self_calibration.ticket_check import departure_of
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sweeps.disagreement import Disagreement
from yieldmon.engine.sweeps.sweep import PlateSweep
from yieldmon.engine.sweeps.sweep_inputs import SweepAbort
from yieldmon.engine.sweeps.sweep_windows import SweepWindows
from yieldmon.estimation.admission import sweep_refusal
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.sweep_worth import OtherChannels
from yieldmon.estimation.waveform.common_bias import KernelMeasurement
from yieldmon.frames import SweepState
from yieldmon.physics.machine import Machine


@dataclass(frozen=True, slots=True)
class ParametersChanged:
    """Other parameters are in use from now on.

    origin: SWEEP, TICKET, KERNELS or DRIFT. reason: one sentence. step: see `CalibrationOutcome`. moisture_pct: of the grain for
    which they hold, nan where not known; None: as measured now. references: (load number, weighed mass in kg) of the tickets
    used.
    """

    parameters: ParameterSet
    origin: ParameterOrigin
    reason: str
    step: CalibrationStep | None = None
    moisture_pct: float | None = None
    references: tuple[tuple[int, float], ...] = ()


class ParameterUpdater:
    """The estimator in use, and the parts that update it."""

    def __init__(
        self,
        settings: EngineSettings,
        machine: Machine,
        estimator: FlowEstimator,
        calibrator: SelfCalibrator | None,
    ) -> None:
        self.calibrator = calibrator
        self.disagreement = Disagreement(settings.disagreement, machine)
        self._sweeps = settings.sweep
        self._home_rad = machine.home_plate_angle_rad
        self._leaves_home = settings.sweep.enabled
        self._sweeps_come = calibrator is not None and settings.sweep.enabled and settings.sweep.when == "interval"
        self._weighed = False
        self._put(estimator, None, weighed=False)
        self.outcome: CalibrationOutcome | None = None
        """Outcome of the last complete sweep or weighed mass; None once it is taken back or of another crop."""
        self.scale_alarm = ScaleAlarm(settings.faults)
        self.masses = ReferenceMasses(settings.reference_masses)
        self._sweep_windows = SweepWindows(self.disagreement, machine.home_plate_angle_rad)

    @property
    def masses_wait(self) -> bool:
        """Whether a reference mass has not been handed to the calibrator yet."""
        return self.masses.wait and self.calibrator is not None

    @property
    def counted_loads(self) -> frozenset[int]:
        """See `Monitor.counted_loads`."""
        return frozenset() if self.calibrator is None else self.masses.loads_named(self.calibrator.counted)

    @property
    def scale_counted(self) -> bool:
        """See `Monitor.scale_counted`."""
        return self.calibrator is not None and any(name_of(mass) in self.calibrator.counted for mass in self.masses.of_scale)

    @property
    def doubted_loads(self) -> frozenset[int]:
        """See `Monitor.doubted_loads`."""
        return frozenset() if self.calibrator is None else self.masses.loads_named(self.calibrator.doubted)

    def update_again(
        self,
        load_numbers: frozenset[int],
        again: Sequence[Weighing],
        rests_on: frozenset[int] | None,
        *,
        loads: tuple[LoadSummary, ...],
        now_s: float,
        crop: str,
        stay: Sequence[Weighing] = (),
    ) -> None:
        """Tickets for these loads were taken back; those of `again` will update the parameters from before them.

        rests_on: loads whose tickets the parameters in use rest on; None: the parameters did not change. crop: of all these,
        where another crop is harvested now, else "". stay: as for `Monitor.update_again`.

        Raises ValueError as `ticket`.
        """
        tickets = self.masses.tickets
        references, kept = (
            [tickets.ticket(Weighing(*one), loads=loads, now_s=now_s) for one in weighings] for weighings in (again, stay)
        )
        gone = load_numbers | {reference.load_number for reference in (*references, *kept)}
        left = tickets.take_back(gone, references, crop, kept)
        counted = None
        if rests_on is not None and not crop:
            self.outcome = None
            waiting = tickets.waiting
            counted = [ticket for ticket in left if ticket.load_number in rests_on and ticket not in waiting]
        calibrator = self.calibrator
        scale = calibrator is not None and calibrator.forget(gone, self.estimator, counted, self.masses.of_scale)
        if not crop:
            self.masses.wait_again(scale=scale)

    @property
    def last_update(self) -> str:
        """The outcome of the last complete sweep or weighed mass, in a sentence."""
        if self.outcome is not None:
            return self.outcome.reason
        return "no calibrator" if self.calibrator is None else "the parameters have been replaced since"

    def use(self, estimator: FlowEstimator, calibration_age_s: float | None, harvested_kg: float = 0.0) -> None:
        """Use other parameters. calibration_age_s: time since their calibration, None where not known; harvested_kg: grain since
        then."""
        self._put(estimator, calibration_age_s, weighed=False)
        if self.calibrator is not None:
            self.calibrator.use(estimator, harvested_kg)

    def _put(self, estimator: FlowEstimator, calibration_age_s: float | None, *, weighed: bool) -> None:
        self.estimator = estimator
        self.drift_sd = 0.0
        """Relative, of the force, by drift since the last update of the parameters in use."""
        self.calibration_age_s = calibration_age_s
        self._sweeps_update = not sweep_refusal(estimator.parameters)
        self.judge_model(weighed=weighed)

    def judge_model(self, *, weighed: bool | None = None) -> None:
        """Update `model_error` and `load_error` from the sweeps. weighed: whether a weighed mass has set the parameters; None:
        unchanged."""
        parameters = self.estimator.parameters
        self._weighed = parameters.is_weighed or (self._weighed if weighed is None else weighed)
        unseen = self._leaves_home and not self.disagreement.seen
        disagreement, angles_deg = self.disagreement, self._sweeps.angles_deg
        found = disagreement.unswept_error(parameters, angles_deg) if unseen else disagreement.model_error(parameters)
        beyond = max(found.home**2 - parameters.own_error**2 - parameters.scale_error**2, 0.0) ** 0.5
        self.model_error = found.with_home(0.0 if unseen or self._weighed else beyond, self._home_rad)
        """Error of the force as sweeps show it; before the first sweep, away from home, what a sweep may show. At home it is what
        exceeds the parameters' own_error, and 0 once a weighed mass has set the scale."""
        unswept = unseen and self._sweeps_come and self._sweeps_update and not self._weighed
        self.load_error = found.with_home(beyond, self._home_rad) if unswept else self.model_error
        """Error for the budgets of loads and total: before the first scheduled sweep, also what it may show at home."""

    def change_grain(self, before: str, now: str, estimator: FlowEstimator | None = None) -> None:
        """Another crop from now on; waiting masses of the crop before update its parameters when it returns. estimator: in use
        from now on."""
        used = self.masses.change_crop(before, now)
        self.outcome = None
        if self.calibrator is not None:
            self.calibrator.change_grain(before, now, used, estimator)

    def totals_reset(self, before_kg: float) -> None:
        """The total begins anew at 0; it was before_kg."""
        self.masses.totals_reset()
        if self.calibrator is not None:
            self.calibrator.totals_reset(before_kg)

    def take_tickets_of(self, before: ParameterUpdater) -> None:
        """After a reload: take over the tickets of the updater in use until now."""
        tickets = before.masses.tickets
        self.masses.tickets.take_crops_of(tickets)
        self.remember_tickets(tickets.kept, tickets.waiting)

    def restore_age(self, calibration_age_s: float | None) -> None:
        """After a restart: time since the parameters were calibrated, s; None where it is not known."""
        self.calibration_age_s = calibration_age_s

    def add_age(self, seconds: float) -> None:
        """Add to the age of the calibration, s."""
        if self.calibration_age_s is not None:
            self.calibration_age_s += seconds

    def ticket(self, weighing: Weighing, *, loads: tuple[LoadSummary, ...], now_s: float, crop: str = "") -> ReferenceMass:
        """A scale ticket for a load; see `Monitor.ticket`."""
        reference = self.masses.tickets.ticket(weighing, loads=loads, now_s=now_s)
        self.masses.enter(reference, crop)
        return reference

    def departure(
        self,
        weighing: Weighing,
        *,
        loads: tuple[LoadSummary, ...],
        now_s: float,
        of_crop: FlowEstimator | None = None,
    ) -> tuple[float, float] | None:
        """See `Monitor.ticket_departure`."""
        reference = self.masses.tickets.ticket(weighing, loads=loads, now_s=now_s)
        return departure_of(reference, of_crop or self.estimator, self.drift_sd, self.model_error)

    def remember_tickets(self, tickets: Sequence[ReferenceMass], waiting: Sequence[ReferenceMass]) -> None:
        """After a restart or a reload: tickets entered before; `waiting`: those of them not used yet."""
        self.masses.remember(tickets, waiting)
        if self.calibrator is not None:
            self.calibrator.remember([a for a in tickets if a not in waiting], self.estimator, self.model_error)

    def update(
        self, at_s: float, record: WindowRecord, sweep: PlateSweep, channels: OtherChannels | None = None
    ) -> tuple[ParametersChanged, ...]:
        """Collect a sweep's windows, and hand them to the calibrator at its end; between sweeps, update from reference masses.

        Parameters that sweeps cannot update start no scheduled sweeps: their flow is least accurate away from home. channels:
        estimators beside the mean force, for `sweep.when: information`.

        Returns
        -------
        tuple of ParametersChanged
            In order.
        """
        sweep.schedule.by_schedule = self.calibrator is None or (
            self._sweeps_update and self._may_begin(at_s, record, sweep, channels)
        )
        windows, parameters = self._sweep_windows, self.estimator.parameters
        if not sweep.visiting and not sweep.completed:
            if windows.between(record, sweep, parameters):
                self.judge_model()
            return self._update_from_masses(record) or self._follow_drift(record)
        if windows.within(record, sweep, parameters):
            self.judge_model()
        if not sweep.completed:
            return ()
        records = windows.whole()
        if sweep.implausible_feedback():
            sweep.abort(at_s, SweepAbort.FORCE_DOES_NOT_FOLLOW)
            windows.end_early(record, sweep.abort_reason, parameters)
            self.judge_model()
            return ()
        self.disagreement.add(records, parameters)
        self.judge_model()
        weighed: tuple[ParametersChanged, ...] = ()
        changed: tuple[ParametersChanged, ...] = ()
        if self.calibrator is not None:
            # First a weighed mass that came during the sweep, as between sweeps.
            weighed = self._update_from_masses(record)
            changed = self._take(self.calibrator.update(records, self.estimator, use_sweep=not self.disagreement.present))
        sweep.finish(at_s, bool(changed))
        return (*weighed, *changed)

    def _may_begin(self, at_s: float, record: WindowRecord, sweep: PlateSweep, channels: OtherChannels | None) -> bool:
        """Whether a sweep may begin by schedule; one that is due and gains too little is declined."""
        settings = self._sweeps
        if settings.when == "interval" or self.calibrator is None or sweep.state is SweepState.WAITING:
            return True
        if not sweep.could_begin(at_s):
            return False
        stops = [angle for angle in sweep.sequence for _ in range(settings.windows_per_step)]
        worth = self.calibrator.sweep_worth(record, stops, channels or OtherChannels(), self.estimator)
        if worth is None or worth.ratio >= settings.worth_ratio:
            return True
        at_home, swept = 100.0 * worth.at_home_sd, 100.0 * worth.with_sweep_sd
        sweep.schedule.decline(at_s, f"a sweep would leave {swept:.2g} % on the flow, as long at home {at_home:.2g} %")
        return False

    def update_from_kernels(self, measurement: KernelMeasurement, record: WindowRecord) -> tuple[ParametersChanged, ...]:
        """An update by kernel noise, between sweeps."""
        if self.calibrator is None:
            return ()
        outcome = self.calibrator.update_from_kernels(record, measurement, self.estimator)
        # Kernel noise does not change whether the last sweep determined the parameters.
        known = self.outcome is None or self.outcome.identifiable
        return self._take(replace(outcome, identifiable=known), ParameterOrigin.KERNELS)

    def _update_from_masses(self, record: WindowRecord) -> tuple[ParametersChanged, ...]:
        """Update from reference masses that came since the last update; of several tickets one with each window, in the order of
        entry, as if they had been entered one at a time."""
        if not self.masses.wait:
            return ()
        if self.calibrator is None:
            self.scale_alarm.see(self.masses.compare())
            return ()
        handed, kept = self.masses.hand_over()
        changed = self._take(self.calibrator.weigh(record, kept, self.estimator, self.load_error))
        references = tuple((ticket.load_number, ticket.reference_kg) for ticket in handed)
        return tuple(replace(change, references=references) for change in changed)

    def _follow_drift(self, record: WindowRecord) -> tuple[ParametersChanged, ...]:
        """Between updates, move the parameters by their estimated steady drift."""
        if self.calibrator is None:
            return ()
        outcome = self.calibrator.follow(record, self.estimator)
        if outcome is None or outcome.estimator is None:
            self.drift_sd = self.calibrator.drift_std_dev(record, self.estimator)
            return ()
        self._put(outcome.estimator, self.calibration_age_s, weighed=self._weighed)
        return (ParametersChanged(outcome.estimator.parameters, ParameterOrigin.DRIFT, outcome.reason, outcome.step, nan),)

    def _take(self, outcome: CalibrationOutcome, by: ParameterOrigin | None = None) -> tuple[ParametersChanged, ...]:
        self.outcome = outcome
        self.scale_alarm.see(outcome.checks)
        if outcome.estimator is None:
            return ()
        self._put(outcome.estimator, 0.0, weighed=outcome.weighed or self._weighed)
        origin = by or (ParameterOrigin.TICKET if outcome.weighed else ParameterOrigin.SWEEP)
        # A sweep leaves the scale as it was; a weighed mass's scale is that of its own grain.
        moisture_pct = None if outcome.moved_by_moisture or by else self._weighed_moisture_pct() if outcome.weighed else nan
        return (ParametersChanged(outcome.estimator.parameters, origin, outcome.reason, outcome.step, moisture_pct),)

    def _weighed_moisture_pct(self) -> float:
        """Mean moisture of the grain weighed last, %; nan where not known."""
        references = self.masses.kept
        forces = references[-1].forces if references else None
        if forces is None:
            return nan
        return float(np.average(forces.moisture_pct, weights=forces.duration_s))
