"""What the monitor learns: sweeps and reference masses in, other parameters out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import hypot, nan

import numpy as np

from yieldmon.engine.flow import Flow
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.inputs import InputSnapshot
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.sampling.windows import Window
from yieldmon.engine.self_calibration.anchors import ReferenceMass, TankScale, Weighing
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome, CalibrationStep, SelfCalibrator
from yieldmon.engine.self_calibration.scale_alarm import ScaleAlarm, ScaleCheck, as_stated, name_of
from yieldmon.engine.self_calibration.ticket_book import TicketBook
from yieldmon.engine.self_calibration.ticket_check import departure_of
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sweeps.disagreement import Disagreement
from yieldmon.engine.sweeps.sweep import SweepMachine
from yieldmon.engine.sweeps.sweep_inputs import SweepAbort
from yieldmon.engine.sweeps.sweep_windows import SweepWindows
from yieldmon.estimation.admission import refusal
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.sweep_worth import OtherChannels
from yieldmon.estimation.waveform.common_bias import KernelLesson
from yieldmon.frames import EstimateQuality, SweepState
from yieldmon.physics.machine import Machine


@dataclass(frozen=True, slots=True)
class ParametersChanged:
    """Other parameters from now on. origin: "sweep", "ticket" (a reference mass alone), "kernels" or "drift"; reason: one
    sentence; step: see `CalibrationOutcome`. moisture_pct: of the grain for which they hold, nan where it is not known;
    None: as measured now. taught: number and weighed mass, kg, of the loads whose tickets were handed over for it."""

    parameters: ParameterSet
    origin: str
    reason: str
    step: CalibrationStep | None = None
    moisture_pct: float | None = None
    taught: tuple[tuple[int, float], ...] = ()


class Learning:
    """The estimator in use, and all that may change it."""

    def __init__(
        self,
        settings: EngineSettings,
        machine: Machine,
        estimator: FlowEstimator,
        calibrator: SelfCalibrator | None,
        *,
        drives_plate: bool = False,
    ) -> None:
        self.calibrator = calibrator
        self.disagreement = Disagreement(settings.disagreement, machine)
        self._sweeps = settings.sweep
        self._home_rad = machine.home_plate_angle_rad
        self._leaves_home = drives_plate and settings.sweep.enabled
        self._sweeps_come = (
            drives_plate and calibrator is not None and settings.sweep.enabled and settings.sweep.when == "interval"
        )
        self._weighed = False
        self._put(estimator, None, weighed=False)
        self.outcome: CalibrationOutcome | None = None
        """What the last whole sweep or weighed mass changed; None once that is taken back or of another crop."""
        self.scale_alarm = ScaleAlarm(settings.faults)
        self._scale = TankScale(settings.anchors)
        self.tickets = TicketBook(settings.anchors.keep)
        self._masses_new = False
        self._compared: frozenset[ReferenceMass] = frozenset()
        self._weighed_s = float("-inf")
        self._sweep_windows = SweepWindows(self.disagreement, machine.home_plate_angle_rad)

    @property
    def anchors(self) -> tuple[ReferenceMass, ...]:
        """Reference masses kept, by time."""
        return tuple(sorted((*self._scale.anchors, *self.tickets.kept), key=lambda anchor: anchor.end_s))

    @property
    def masses_wait(self) -> bool:
        """Whether a reference mass has come that was not handed to the calibrator yet."""
        return self._masses_new and self.calibrator is not None

    @property
    def counted_loads(self) -> frozenset[int]:
        """See `Monitor.counted_loads`."""
        counted = frozenset() if self.calibrator is None else self.calibrator.counted
        return self._ticketed(counted)

    @property
    def scale_counted(self) -> bool:
        """See `Monitor.scale_counted`."""
        counted = frozenset() if self.calibrator is None else self.calibrator.counted
        return any(name_of(anchor) in counted for anchor in self._scale.anchors)

    @property
    def doubted_loads(self) -> frozenset[int]:
        """See `Monitor.doubted_loads`."""
        return self._ticketed(frozenset() if self.calibrator is None else self.calibrator.doubted)

    def load_of(self, check: ScaleCheck) -> int:
        """Number of the load whose ticket was checked; 0 for a mass of the tank scale."""
        return next((ticket.load_number for ticket in self.tickets.of_any_crop if name_of(ticket) == check.name), 0)

    def _ticketed(self, names: frozenset[str]) -> frozenset[int]:
        """Loads of these names that have a ticket."""
        if not names:
            return frozenset()
        return frozenset(ticket.load_number for ticket in self.tickets.of_any_crop if name_of(ticket) in names)

    def teach_again(
        self,
        load_numbers: frozenset[int],
        again: Sequence[Weighing],
        learnt: frozenset[int] | None,
        loads: tuple[LoadSummary, ...],
        now_s: float,
        crop: str,
    ) -> None:
        """Tickets for these loads were taken back, and with the parameters that they led to what others had taught: these teach
        again. learnt: loads whose tickets the parameters rest on, None where these are as before. crop: of all, where another one
        is harvested now, else "".

        Raises ValueError as `ticket`.
        """
        anchors = [self.tickets.ticket(*weighing, loads, now_s) for weighing in again]
        gone = load_numbers | {anchor.load_number for anchor in anchors}
        if learnt is not None and not crop:
            self.outcome = None
        left = self.tickets.take_back(gone, anchors, crop)
        scale_again = False
        if self.calibrator is not None:
            counted = None
            if learnt is not None and not crop:
                waiting = self.tickets.waiting
                counted = [ticket for ticket in left if ticket.load_number in learnt and ticket not in waiting]
            scale_again = self.calibrator.forget(gone, self.estimator, counted, tuple(self._scale.anchors))
        if not crop:
            scale_waits = scale_again or (self._masses_new and bool(self._scale.anchors))
            self._masses_new = bool(self.tickets.waiting) or scale_waits

    @property
    def last_update(self) -> str:
        """What the last whole sweep or weighed mass changed, in a sentence."""
        if self.outcome is not None:
            return self.outcome.reason
        return "no calibrator" if self.calibrator is None else "the parameters have been replaced since"

    def use(self, estimator: FlowEstimator, calibration_age_s: float | None, harvested_kg: float = 0.0) -> None:
        """Other parameters; calibration_age_s: time since they were calibrated, None where it is not known; harvested_kg: grain
        since then."""
        self._put(estimator, calibration_age_s, weighed=False)
        if self.calibrator is not None:
            self.calibrator.use(estimator, harvested_kg)

    def _put(self, estimator: FlowEstimator, calibration_age_s: float | None, *, weighed: bool) -> None:
        self.estimator = estimator
        self.drift_sd = 0.0
        """Relative, of the force, by drift since the parameters in use were learnt."""
        self.calibration_age_s = calibration_age_s
        self._sweeps_teach = not refusal(estimator.parameters)
        self.judge_model(weighed=weighed)

    def judge_model(self, *, weighed: bool | None = None) -> None:
        """Ask the sweeps' patterns how far the force of the parameters in use may be off. weighed: whether a weighed mass has set
        them; None: as before."""
        parameters = self.estimator.parameters
        self._weighed = parameters.is_weighed or (self._weighed if weighed is None else weighed)
        unseen = self._leaves_home and not self.disagreement.seen
        found = self.disagreement.unswept_error(parameters) if unseen else self.disagreement.model_error(parameters)
        home = 0.0 if unseen or self._weighed else max(found.home**2 - parameters.model_error**2, 0.0) ** 0.5
        self.model_error = found.with_home(home, self._home_rad)
        """By what sweeps show, away from home before the first one by what it may show; at home beyond the parameters' own
        model_error, and none once a weighed mass has set the scale."""
        unswept = unseen and self._sweeps_come and self._sweeps_teach and not self._weighed
        self.load_error = found if unswept else self.model_error
        """That loads and total are stated with: before the first sweep by schedule, what it may show at home too."""

    def change_grain(self, before: str, now: str, estimator: FlowEstimator | None = None) -> None:
        """Another crop from now on: weighed masses of the one before teach its parameters alone, when it is back. estimator: in
        use from now on."""
        used = self.tickets.change_crop(before, now)
        self.outcome = None
        self._scale.forget()
        self._scale.anchors.clear()
        self._masses_new = bool(self.tickets.waiting)
        if self.calibrator is not None:
            self.calibrator.change_grain(before, now, used, estimator)

    def totals_reset(self, before_kg: float) -> None:
        """The total begins anew at 0; it was before_kg."""
        self._scale.forget()
        if self.calibrator is not None:
            self.calibrator.totals_reset(before_kg)

    def zero_undone(self) -> None:
        """Masses have changed that were measured with another zero: forces over them say nothing, nor does the total's rise."""
        self.tickets.forces.forget()
        self._scale.forget()

    def take_tickets_of(self, before: Learning) -> None:
        """After a reload: the tickets of the one that learnt until now."""
        self.tickets.take_crops_of(before.tickets)
        self.remember_tickets(before.tickets.kept, before.tickets.waiting)

    def grow_older(self, seconds: float) -> None:
        """Time passes since the calibration."""
        if self.calibration_age_s is not None:
            self.calibration_age_s += seconds

    def match_tank_scale(
        self,
        window: Window,
        inputs: InputSnapshot,
        flow: Flow,
        total_before_kg: float,
        mass_kg: float,
        budget: MassBudget,
        *,
        zero_doubted: bool,
    ) -> float:
        """Match the tank scale's stable readings with what a window measured; budget: of the total after it.

        Returns kg that were missed, by the scale, while the zero was doubted.
        """
        if zero_doubted:
            self._scale.doubt_zero()
        if inputs.tank_disputed:
            self._scale.forget()
            return 0.0
        if inputs.tank_time_s != self._weighed_s:
            self._weighed_s = inputs.tank_time_s
            self._scale.reading(inputs.tank_time_s, inputs.tank_kg)
        # Between passes the plate is watched as in them, and no grain comes.
        watched = (flow.measured or flow.quality is EstimateQuality.NOT_HARVESTING) and not window.contested
        weighed = self._scale.window(window.start_s, window.end_s, total_before_kg, mass_kg, watched, budget)
        if weighed is None:
            return 0.0
        if not weighed.zero_doubted:
            self._masses_new = True
            return 0.0
        missed_kg = max(0.0, weighed.reference_kg - weighed.measured_kg)
        self._scale.counted(missed_kg)
        return missed_kg

    def next_weighed(self, ahead: Iterable[InputSnapshot]) -> int:
        """With which of the windows ahead a mass may be weighed that changes the parameters, counted from 1; 0 for none."""
        return self._scale.next_mass(inputs.tank_kg for inputs in ahead)

    def empty_since(self, time_s: float) -> None:
        """No grain came between a time and now, though no flow could be given."""
        self._scale.empty_since(time_s)

    def ticket(
        self, load_number: int, mass_kg: float, std_dev_kg: float, loads: tuple[LoadSummary, ...], now_s: float
    ) -> ReferenceMass:
        """A scale ticket for a load; see `Monitor.ticket`."""
        anchor = self.tickets.ticket(load_number, mass_kg, std_dev_kg, loads, now_s)
        self.tickets.enter(anchor)
        self._masses_new = True
        return anchor

    def departure(
        self, load_number: int, mass_kg: float, std_dev_kg: float, loads: tuple[LoadSummary, ...], now_s: float
    ) -> tuple[float, float] | None:
        """See `Monitor.ticket_departure`."""
        anchor = self.tickets.ticket(load_number, mass_kg, std_dev_kg, loads, now_s)
        return departure_of(anchor, self.estimator, hypot(self.drift_sd, self.model_error.home))

    def remember_tickets(self, tickets: Sequence[ReferenceMass], waiting: Sequence[ReferenceMass]) -> None:
        """After a restart or a reload: tickets entered before it; `waiting` are those among them that have not been used."""
        self.tickets.remember(tickets, waiting)
        self._compared = frozenset(tickets)
        if self.calibrator is not None:
            self.calibrator.remember([a for a in tickets if a not in waiting], self.estimator)
        self._masses_new = self._masses_new or bool(waiting)

    def learn(
        self, at_s: float, record: WindowRecord, sweep: SweepMachine, channels: OtherChannels | None = None
    ) -> tuple[ParametersChanged, ...]:
        """Collect a sweep's windows, and at its end hand them to the calibrator; between sweeps reference masses update.

        Where sweeps update nothing they are not begun by schedule: away from home such a model misses the most. channels: what
        gives the flow beside the mean force, for `sweep.when: information`.
        """
        sweep.by_schedule = self.calibrator is None or (self._sweeps_teach and self._worth_making(at_s, record, sweep, channels))
        windows, parameters = self._sweep_windows, self.estimator.parameters
        if not sweep.visiting and not sweep.completed:
            if windows.between(record, sweep, parameters):
                self.judge_model()
            return self._learn_from_masses(record) or self._follow_drift(record)
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
            # Each weighed mass that came during the sweep first, by the same rule as between sweeps.
            weighed = self._learn_from_masses(record)
            changed = self._take(self.calibrator.update(records, self.estimator, use_sweep=not self.disagreement.present))
        sweep.finish(at_s, bool(changed))
        return (*weighed, *changed)

    def _worth_making(self, at_s: float, record: WindowRecord, sweep: SweepMachine, channels: OtherChannels | None) -> bool:
        """Whether a sweep may begin by schedule; one that is due and not worth making is declined."""
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
        sweep.decline(at_s, f"a sweep would leave {swept:.2g} % on the flow, as long at home {at_home:.2g} %")
        return False

    def hear(self, lesson: KernelLesson, record: WindowRecord) -> tuple[ParametersChanged, ...]:
        """A lesson of kernel noise, between sweeps."""
        if self.calibrator is None:
            return ()
        outcome = self.calibrator.hear(record, lesson, self.estimator)
        # What the last sweep determined stays as it was.
        known = self.outcome is None or self.outcome.identifiable
        return self._take(replace(outcome, identifiable=known), "kernels")

    def _learn_from_masses(self, record: WindowRecord) -> tuple[ParametersChanged, ...]:
        """Hand reference masses that have come since the last update to the calibrator; of several tickets one with each window,
        in the order of entry, so that they teach what they would have one by one."""
        if not self._masses_new:
            return ()
        if self.calibrator is None:
            self._masses_new = False
            self.tickets.none_waits()
            self._compare()
            return ()
        handed = self.tickets.hand_over()
        waiting = self.tickets.waiting
        self._masses_new = bool(waiting)
        anchors = tuple(anchor for anchor in self.anchors if anchor not in waiting)
        changed = self._take(self.calibrator.weigh(record, anchors, self.estimator, self.load_error))
        taught = tuple((ticket.load_number, ticket.reference_kg) for ticket in handed)
        return tuple(replace(change, taught=taught) for change in changed)

    def _follow_drift(self, record: WindowRecord) -> tuple[ParametersChanged, ...]:
        """Between lessons the parameters go on as the lessons together say that they drift."""
        if self.calibrator is None:
            return ()
        outcome = self.calibrator.follow(record, self.estimator)
        if outcome is None or outcome.estimator is None:
            self.drift_sd = self.calibrator.drift_std_dev(record, self.estimator)
            return ()
        self._put(outcome.estimator, self.calibration_age_s, weighed=self._weighed)
        return (ParametersChanged(outcome.estimator.parameters, "drift", outcome.reason, outcome.step, nan),)

    def _compare(self) -> None:
        """Nothing learns: hold new masses against what was counted."""
        checks = [as_stated(anchor) for anchor in self.anchors if anchor not in self._compared]
        self._compared = frozenset(self.anchors)
        self.scale_alarm.see([check for check in checks if check is not None])

    def _take(self, outcome: CalibrationOutcome, by: str = "") -> tuple[ParametersChanged, ...]:
        self.outcome = outcome
        self.scale_alarm.see(outcome.checks)
        if outcome.estimator is None:
            return ()
        self._put(outcome.estimator, 0.0, weighed=outcome.weighed or self._weighed)
        origin = by or ("ticket" if outcome.weighed else "sweep")
        # What a sweep teaches leaves the scale as it was; a weighed mass's scale is that of its own grain.
        moisture_pct = None if outcome.moved_by_moisture or by else self._weighed_moisture_pct() if outcome.weighed else nan
        return (ParametersChanged(outcome.estimator.parameters, origin, outcome.reason, outcome.step, moisture_pct),)

    def _weighed_moisture_pct(self) -> float:
        """Of the grain that was weighed last, mean over its time; nan where it is not known."""
        anchors = self.anchors
        forces = anchors[-1].forces if anchors else None
        if forces is None:
            return nan
        return float(np.average(forces.moisture_pct, weights=forces.duration_s))
