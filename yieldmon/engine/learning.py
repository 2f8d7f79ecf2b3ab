"""What the monitor learns: sweeps and reference masses in, other parameters out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import hypot, isclose, isfinite, nan

import numpy as np

from yieldmon.engine.anchors import AnchorSource, ReferenceMass, TankScale, Weighing
from yieldmon.engine.budget import MassBudget
from yieldmon.engine.disagreement import Disagreement
from yieldmon.engine.flow import Flow
from yieldmon.engine.inputs import InputSnapshot
from yieldmon.engine.load_forces import LoadForces, LoadForceSums
from yieldmon.engine.loads import LoadSummary
from yieldmon.engine.measurement import Reading
from yieldmon.engine.records import CalibrationOutcome, CalibrationStep, FlowEstimator, SelfCalibrator, WindowRecord
from yieldmon.engine.scale_alarm import ScaleAlarm, as_stated, name_of
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.since_zero import KeptSecond
from yieldmon.engine.state import TicketState
from yieldmon.engine.sweep import SweepAbort, SweepMachine
from yieldmon.engine.ticket_check import departure_of
from yieldmon.engine.windows import Window
from yieldmon.estimation.admission import refusal
from yieldmon.estimation.common_bias import KernelLesson
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.sweep_model_error import ModelError
from yieldmon.estimation.sweep_worth import OtherChannels
from yieldmon.frames import EstimateQuality, SweepState
from yieldmon.physics.machine import SAME_ANGLE_RAD, Machine

_KEPT_TICKETS = 12
"""That outlive a restart."""
_WAY_HOME_S = 20.0
"""How long a plate may take home for the flow there to speak of that before."""
_FORCES_HOLD = frozenset({SweepAbort.FLOW_CHANGED, SweepAbort.SPEED_CHANGED, SweepAbort.NOT_MEASURED, SweepAbort.OPERATOR})
"""Ends of a sweep that leave what was measured until then usable."""


@dataclass(frozen=True, slots=True)
class ParametersChanged:
    """Other parameters from now on. origin: "sweep", "ticket" (a reference mass alone), "kernels" or "drift"; reason: one
    sentence; step: see `records.CalibrationOutcome`. moisture_pct: of the grain for which they hold, nan where it is not known;
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
        self, settings: EngineSettings, machine: Machine, estimator: FlowEstimator, calibrator: SelfCalibrator | None
    ) -> None:
        self.calibrator = calibrator
        self.disagreement = Disagreement(settings.disagreement, machine)
        self._sweeps = settings.sweep
        self._put(estimator, None, weighed=False)
        self.outcome: CalibrationOutcome | None = None
        """What the last whole sweep or weighed mass changed."""
        self.scale_alarm = ScaleAlarm(settings.faults)
        self._scale = TankScale(settings.anchors)
        self._tickets: deque[ReferenceMass] = deque(maxlen=settings.anchors.keep)
        self._masses_new = False
        self._waiting: list[ReferenceMass] = []
        """Tickets that were not handed to the calibrator yet."""
        self._of_grain: dict[str, tuple[list[ReferenceMass], list[ReferenceMass]]] = {}
        """Tickets of the crops before, by name: all that are kept, and those that wait for the crop's return."""
        self._earlier: dict[int, tuple[LoadSummary, LoadForces | None]] = {}
        """Loads of an earlier run, by number."""
        self._compared: frozenset[ReferenceMass] = frozenset()
        self.forces = LoadForceSums()
        self._weighed_s = float("-inf")
        self._sweep_records: list[WindowRecord] = []
        self._sweeping = False
        self._home_rad = machine.home_plate_angle_rad
        self._way_home: list[WindowRecord] = []
        """Of a sweep that ended away from home because the flow changed, until the plate is back."""
        self._looked_step = 0
        """Of the sweep under way, at which its pattern was last looked at."""

    @property
    def anchors(self) -> tuple[ReferenceMass, ...]:
        """Reference masses kept, by time."""
        return tuple(sorted((*self._scale.anchors, *self._tickets), key=lambda anchor: anchor.end_s))

    @property
    def masses_wait(self) -> bool:
        """Whether a reference mass has come that was not handed to the calibrator yet."""
        return self._masses_new and self.calibrator is not None

    @property
    def counted_loads(self) -> frozenset[int]:
        """See `Monitor.counted_loads`."""
        counted = frozenset() if self.calibrator is None else self.calibrator.counted
        tickets = (*self._tickets, *(anchor for kept, _ in self._of_grain.values() for anchor in kept))
        return frozenset(anchor.load_number for anchor in tickets if name_of(anchor) in counted)

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
        anchors = [self._anchor(*weighing, loads, now_s) for weighing in again]
        gone = load_numbers | {anchor.load_number for anchor in anchors}
        tickets, waiting = self._of_grain.get(crop, ([], [])) if crop else (list(self._tickets), self._waiting)
        tickets, waiting = _without(tickets, gone), [*_without(waiting, gone), *anchors]
        if self.calibrator is not None:
            counted = None
            if learnt is not None and not crop:
                counted = [anchor for anchor in tickets if anchor.load_number in learnt and anchor not in waiting]
            self.calibrator.forget(gone, self.estimator, counted)
        if crop:
            self._of_grain[crop] = [*tickets, *anchors], waiting
            return
        self._tickets = deque([*tickets, *anchors], maxlen=self._tickets.maxlen)
        self._waiting = waiting
        self._masses_new = bool(waiting) or (self._masses_new and bool(self._scale.anchors))

    @property
    def last_update(self) -> str:
        """What the last whole sweep or weighed mass changed, in a sentence."""
        return self.outcome.reason if self.outcome is not None else "no calibrator"

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
        self._weighed = weighed
        self.judge_model()

    def judge_model(self, *, weighed: bool | None = None) -> None:
        """Ask the sweeps' patterns how far the force of the parameters in use may be off. weighed: whether a weighed mass has set
        them; None: as before."""
        self._weighed = self._weighed if weighed is None else weighed
        parameters = self.estimator.parameters
        found = self.disagreement.model_error(parameters)
        home = 0.0 if self._weighed else max(found.home**2 - parameters.model_error**2, 0.0) ** 0.5
        self.model_error = ModelError(home, found.away)
        """By what sweeps show; at home beyond the parameters' own model_error, and none once a weighed mass has set the scale."""

    def change_grain(self, before: str, now: str, estimator: FlowEstimator | None = None) -> None:
        """Another crop from now on: weighed masses of the one before teach its parameters alone, when it is back. estimator: in
        use from now on."""
        self._of_grain[before] = list(self._tickets), self._waiting
        tickets, self._waiting = self._of_grain.pop(now, ([], []))
        self._tickets = deque(tickets, maxlen=self._tickets.maxlen)
        self._scale.forget()
        self._scale.anchors.clear()
        self._masses_new = bool(self._waiting)
        if self.calibrator is not None:
            self.calibrator.change_grain(before, now, [a for a in tickets if a not in self._waiting], estimator)

    def totals_reset(self, before_kg: float) -> None:
        """The total begins anew at 0; it was before_kg."""
        self._scale.forget()
        if self.calibrator is not None:
            self.calibrator.totals_reset(before_kg)

    def zero_undone(self) -> None:
        """Masses have changed that were measured with another zero: forces over them say nothing, nor does the total's rise."""
        self.forces.forget()
        self._scale.forget()

    def take_tickets_of(self, before: Learning) -> None:
        """After a reload: the tickets of the one that learnt until now."""
        self._of_grain = dict(before._of_grain)
        self.remember_tickets(before.tickets, before.waiting)

    def grow_older(self, seconds: float) -> None:
        """Time passes since the calibration."""
        if self.calibration_age_s is not None:
            self.calibration_age_s += seconds

    def weighed(
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

    def measured(self, load_number: int, reading: Reading, flow: Flow, mass_kg: float) -> None:
        """A window that added mass to a load."""
        if mass_kg > 0.0:
            window = reading.window
            self.forces.add(
                load_number,
                mass_kg,
                mass_kg / flow.rate_kg_s,
                force_n=flow.force_n,
                angle_rad=window.plate_angle_rad,
                speed_rad_s=window.speed_rad_s,
                moisture_pct=reading.inputs.fresh["moisture"],
            )

    def ticket(
        self, load_number: int, mass_kg: float, std_dev_kg: float, loads: tuple[LoadSummary, ...], now_s: float
    ) -> ReferenceMass:
        """A scale ticket for a load; see `Monitor.ticket`."""
        anchor = self._anchor(load_number, mass_kg, std_dev_kg, loads, now_s)
        self._tickets.append(anchor)
        self._waiting.append(anchor)
        self._masses_new = True
        return anchor

    def departure(
        self, load_number: int, mass_kg: float, std_dev_kg: float, loads: tuple[LoadSummary, ...], now_s: float
    ) -> tuple[float, float] | None:
        """See `Monitor.ticket_departure`."""
        anchor = self._anchor(load_number, mass_kg, std_dev_kg, loads, now_s)
        return departure_of(anchor, self.estimator, hypot(self.drift_sd, self.model_error.home))

    def _anchor(
        self, load_number: int, mass_kg: float, std_dev_kg: float, loads: tuple[LoadSummary, ...], now_s: float
    ) -> ReferenceMass:
        if not (isfinite(mass_kg) and mass_kg > 0.0):
            raise ValueError(f"ticket for load {load_number}: mass {mass_kg} kg; expected a mass above 0 kg")
        if not (isfinite(std_dev_kg) and std_dev_kg > 0.0):
            raise ValueError(f"ticket for load {load_number}: standard deviation {std_dev_kg} kg; expected above 0 kg")
        load = next((load for load in reversed(loads) if load.number == load_number), None)
        forces = self.forces.of(load_number)
        if load is None and load_number in self._earlier:
            load, forces = self._earlier[load_number]
        if load is None:
            known = sorted(load.number for load in loads)
            raise ValueError(f"ticket for load {load_number}: no such load; expected one of {known}")
        return _ticket(load, forces, mass_kg, std_dev_kg, now_s)

    def know_load(self, load: LoadSummary, seconds: Iterable[KeptSecond]) -> None:
        """A closed load that an earlier run measured, so that a ticket for it updates the parameters."""
        sums = LoadForceSums()
        for second in seconds:
            sums.add(
                load.number,
                second.mass_kg,
                second.duration_s,
                force_n=second.force_n,
                angle_rad=second.plate_angle_rad,
                speed_rad_s=second.elevator_speed_rad_s,
                moisture_pct=second.moisture_pct,
            )
        self._earlier[load.number] = load, sums.of(load.number)

    def of_earlier_load(self, load_number: int, mass_kg: float, std_dev_kg: float) -> ReferenceMass | None:
        """A ticket that an earlier run took for a load of its own; None for a load that is not known."""
        if load_number not in self._earlier:
            return None
        return _ticket(*self._earlier[load_number], mass_kg, std_dev_kg, nan)

    @property
    def tickets(self) -> tuple[ReferenceMass, ...]:
        """Those kept, in the order they were entered."""
        return tuple(self._tickets)

    @property
    def waiting(self) -> tuple[ReferenceMass, ...]:
        """Tickets that were not handed to the calibrator yet."""
        return tuple(self._waiting)

    @property
    def ticket_states(self) -> tuple[TicketState, ...]:
        """What of the tickets is to outlive a restart."""
        in_use: tuple[None, list[ReferenceMass], list[ReferenceMass]] = None, list(self._tickets), self._waiting
        return tuple(
            TicketState(a.load_number, a.reference_kg, a.std_dev_kg, a in waiting, crop)
            for crop, tickets, waiting in (*((name, *of_one) for name, of_one in self._of_grain.items()), in_use)
            for place, a in enumerate(tickets)
            if place >= len(tickets) - _KEPT_TICKETS or a in waiting
        )

    def remember_tickets(self, tickets: Sequence[ReferenceMass], waiting: Sequence[ReferenceMass]) -> None:
        """After a restart or a reload: tickets entered before it; `waiting` are those among them that have not been used."""
        self._tickets.extend(tickets)
        self._compared = frozenset(tickets)
        if self.calibrator is not None:
            self.calibrator.remember([a for a in tickets if a not in waiting], self.estimator)
        self._waiting = list(waiting)
        self._masses_new = self._masses_new or bool(waiting)

    def remember_tickets_of(self, crop: str, tickets: Sequence[ReferenceMass], waiting: Sequence[ReferenceMass]) -> None:
        """After a restart: the same of a crop that is not harvested now."""
        self._of_grain[crop] = list(tickets), list(waiting)

    def learn(
        self, at_s: float, record: WindowRecord, sweep: SweepMachine, channels: OtherChannels | None = None
    ) -> tuple[ParametersChanged, ...]:
        """Collect a sweep's windows, and at its end hand them to the calibrator; between sweeps reference masses update.

        Where sweeps update nothing they are not begun by schedule: away from home such a model misses the most. channels: what
        gives the flow beside the mean force, for `sweep.when: information`.
        """
        sweep.by_schedule = self.calibrator is None or (self._sweeps_teach and self._worth_making(at_s, record, sweep, channels))
        if not sweep.visiting and not sweep.completed:
            if self._sweeping:
                self._end_early(record, sweep.abort_reason)
            elif self._way_home:
                self._come_home(record)
            self._sweep_records = [*self._sweep_records, record][-sweep.lead :] if sweep.lead else []
            return self._learn_from_masses(record) or self._follow_drift(record)
        self._way_home = []
        self._sweeping = not sweep.completed
        if record.usable_for_calibration:
            self._sweep_records.append(record)
            if sweep.is_home_again(record.sweep_step) and record.sweep_step != self._looked_step:
                # Home again: the flow of the visits since is known, and with it how far the force was off there.
                self._looked_step = record.sweep_step
                self._look(self._sweep_records)
        if not sweep.completed:
            return ()
        records, self._sweep_records = self._sweep_records, []
        self._looked_step = 0
        if sweep.implausible_feedback():
            sweep.abort(at_s, SweepAbort.FORCE_DOES_NOT_FOLLOW)
            self._end_early(record, sweep.abort_reason)
            return ()
        self.disagreement.add(records, self.estimator.parameters)
        self.judge_model()
        weighed: tuple[ParametersChanged, ...] = ()
        changed: tuple[ParametersChanged, ...] = ()
        if self.calibrator is not None:
            # Each weighed mass that came during the sweep first, by the same rule as between sweeps.
            weighed = self._learn_from_masses(record)
            changed = self._take(self.calibrator.update(records, self.estimator, use_sweep=not self.disagreement.present))
        sweep.finish(at_s, bool(changed))
        return (*weighed, *changed)

    def _look(self, records: Sequence[WindowRecord]) -> None:
        self.disagreement.look(records, self.estimator.parameters)
        self.judge_model()

    def _end_early(self, record: WindowRecord, reason: SweepAbort | None) -> None:
        """The sweep under way has ended with this window; what it has shown of the model's error until then is kept."""
        self._sweeping, self._looked_step = False, 0
        if reason is SweepAbort.FLOW_CHANGED:
            # The window that ended it was as good as those before it, and may be the visit home that they need.
            records = [*self._sweep_records, record]
            self._look(records)
            self._way_home = [] if self._is_home(record) else records
        self.disagreement.end_early(usable=reason in _FORCES_HOLD and not self._way_home)
        self.judge_model()

    def _come_home(self, record: WindowRecord) -> None:
        """After a change of flow away from home, which a large error of the model may be: the next window at home tells."""
        if record.time_s - self._way_home[-1].time_s > _WAY_HOME_S:
            self._way_home = []
        elif self._is_home(record) and record.plate_still and isfinite(record.mass_flow_kg_s):
            records, self._way_home = [*self._way_home, record], []
            self._look(records)
            self.disagreement.end_early(usable=True)
            self.judge_model()

    def _is_home(self, record: WindowRecord) -> bool:
        return abs(record.plate_angle_rad - self._home_rad) <= SAME_ANGLE_RAD

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
            self._masses_new, self._waiting = False, []
            self._compare()
            return ()
        waited, self._waiting = self._waiting, _after_first_ticket(self._waiting)
        self._masses_new = bool(self._waiting)
        anchors = tuple(anchor for anchor in self.anchors if anchor not in self._waiting)
        changed = self._take(self.calibrator.weigh(record, anchors, self.estimator))
        handed = waited[: len(waited) - len(self._waiting)]
        taught = tuple((anchor.load_number, anchor.reference_kg) for anchor in handed)
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


def _after_first_ticket(waiting: Sequence[ReferenceMass]) -> list[ReferenceMass]:
    """Those of later tickets: one for several loads shares its mass out over them by what was measured."""
    for place in range(1, len(waiting)):
        last, anchor = waiting[place - 1], waiting[place]
        same = isclose(anchor.reference_kg * last.measured_kg, last.reference_kg * anchor.measured_kg, rel_tol=1e-9)
        if not (same and anchor.load_number == last.load_number + 1):
            return list(waiting[place:])
    return []


def _without(anchors: Iterable[ReferenceMass], load_numbers: frozenset[int]) -> list[ReferenceMass]:
    return [anchor for anchor in anchors if anchor.load_number not in load_numbers]


def _ticket(load: LoadSummary, forces: LoadForces | None, mass_kg: float, std_dev_kg: float, now_s: float) -> ReferenceMass:
    end_s = load.end_s if isfinite(load.end_s) else now_s
    return ReferenceMass(
        AnchorSource.TICKET,
        load.start_s,
        end_s,
        mass_kg,
        std_dev_kg,
        load.measured_kg,
        load.complete,
        load.number,
        load.budget,
        forces=forces,
    )
