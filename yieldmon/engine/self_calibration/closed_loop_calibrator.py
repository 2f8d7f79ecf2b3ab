"""Self-calibration for the monitor: sweeps and reference masses in, parameters out.

Between sweeps the parameters' covariance grows (drift), and moisture moves the prior; what a sweep or a weighed load changes is
`estimation.self_calibration.closed_loop`'s matter. Bus time comes with the records.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from math import inf, isfinite, nan
from typing import NamedTuple

import numpy as np

from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.anchors import ReferenceMass
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome, CalibrationStep
from yieldmon.engine.self_calibration.calibrator_state import CalibratorState, PriorState
from yieldmon.engine.self_calibration.crop_weighings import CropWeighings
from yieldmon.engine.self_calibration.curve_states import aligned
from yieldmon.engine.self_calibration.load_update import LoadUpdate
from yieldmon.engine.self_calibration.mass_anchors import checked, mass_anchor, moisture_sd, weighed, with_angle_error
from yieldmon.engine.self_calibration.parameter_knowledge import KERNEL_NOISE, Carried, Instant, ParameterKnowledge
from yieldmon.engine.self_calibration.prior_states import as_prior_state, as_set, says_as
from yieldmon.engine.self_calibration.scale_alarm import ScaleCheck, name_of
from yieldmon.engine.self_calibration.weighings import KEPT_LOADS
from yieldmon.engine.sweeps.sweep_records import density_anchor, median_moisture_pct, sweep_of
from yieldmon.estimation.admission import allowing_for, refusal
from yieldmon.estimation.load_pattern import EFFECT as LOAD_PATTERN
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import SCALE, WEIGHED, ParameterSet
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError
from yieldmon.estimation.self_calibration.angle_pattern import EFFECT
from yieldmon.estimation.self_calibration.closed_loop import self_calibrate, update_from_tickets
from yieldmon.estimation.self_calibration.closed_loop_inputs import MassAnchor
from yieldmon.estimation.self_calibration.closed_loop_outcome import Outcome, ScaleReport
from yieldmon.estimation.self_calibration.steady_drift import unsure_of_gain
from yieldmon.estimation.self_calibration.sweep_worth import OtherChannels, SweepPlan, SweepWorth, sweep_worth, window_times_s
from yieldmon.estimation.waveform import common_bias
from yieldmon.estimation.waveform.common_bias import KernelLesson
from yieldmon.estimation.weighing.load_inputs import LoadSettings
from yieldmon.estimation.weighing.wrong_tickets import known_slip
from yieldmon.physics.model import ForwardModel

_WORSE = 1.5
"""Of the bias's prior variance, the lasting one of a lesson beyond which it is not of that bias any more."""
_LESSON_SDS = 3.0
"""Deviations of a difference beyond which a lesson contradicts and teaches nothing."""
_LEAST_LOAD_ERROR = 1e-4
"""Of a weighed load's measured mass."""
_KEPT_SETS = 8
"""Parameters before, of which a reference mass may have been measured with any."""


class _Before(NamedTuple):
    """Parameters before, the bus time until which they were in use, and the masses that had been handed over by then."""

    until_s: float
    parameters: ParameterSet
    handed: frozenset[ReferenceMass]


class ClosedLoopCalibrator:
    """A `calibrator.SelfCalibrator`. Each reference mass is used once."""

    def __init__(self, model: ForwardModel, settings: CalibratorSettings | None = None) -> None:
        self._settings = CalibratorSettings() if settings is None else settings
        looks = self._settings.pattern_sd > 0.0 and EFFECT not in model.effects
        self._model = model.with_effects((*model.effects, EFFECT)) if looks else model
        self._knowledge = ParameterKnowledge(self._settings)
        self._used: frozenset[ReferenceMass] = frozenset()
        self._checked: frozenset[ReferenceMass] = frozenset()
        """Held against what was counted."""
        self._history: list[_Before] = []
        self._given: ParameterSet | None = None
        """As they came from outside, for as long as no reference mass has changed them since."""
        self._origin: ParameterSet | None = None
        """As they came from outside."""
        self._restored: ParameterSet | None = None
        """Those in use at a restart or at a crop's return, where it is known what weighed loads made them of."""
        self._updated: ParameterSet | None = None
        """The last set that was handed back."""
        self._last: ParameterSet | None = None
        """Those seen in use last."""
        self._load_settings = LoadSettings(load_error=max(self._settings.anchor_error, _LEAST_LOAD_ERROR))
        self._crops = CropWeighings(self._load_settings)
        self._before: CalibratorState | None = None
        """What was known before a restart."""
        self.last: Outcome | None = None

    def update(self, records: Sequence[WindowRecord], estimator: FlowEstimator, *, use_sweep: bool = True) -> CalibrationOutcome:
        """See calibrator.SelfCalibrator."""
        if not records:
            return CalibrationOutcome(None, "the sweep has no usable window; the parameters stay", identifiable=False)
        used = self._in_use(estimator)
        at = Instant(records[-1].time_s, records[-1].total_kg, median_moisture_pct(records))
        carried = self._knowledge.now(used, at)
        prior = carried.drifting.parameters
        density = density_anchor(records, prior, self._settings)
        if used is not self._updated:
            self._given = used
        self._know_origin(used)
        if density is not None:
            self._given = None
        if not use_sweep and density is None:
            return self._without_sweeps(used, at.time_s)
        refused = refusal(used)
        if refused and density is None:
            return CalibrationOutcome(None, refused, identifiable=False)
        try:
            sweeps = [sweep_of(records)] if use_sweep and not refused else []
            settings = allowing_for(self._settings.closed_loop, prior)
            outcome = self_calibrate(self._model, prior, sweeps, density=density, settings=settings)
            leads = refusal(outcome.parameter_set) if sweeps and outcome.updated else ""
            if (leads or not outcome.consistent) and density is not None:
                outcome = update_from_tickets(self._model, prior, (), density, self._settings.closed_loop)
            elif leads:
                return CalibrationOutcome(None, f"the sweep would put {leads}", identifiable=False)
        except ValueError as error:
            return CalibrationOutcome(None, f"{error}; the parameters stay", identifiable=False)
        return self._taken(outcome, carried, used, at, sweep_alone=density is None)

    def weigh(
        self,
        record: WindowRecord,
        anchors: Sequence[ReferenceMass],
        estimator: FlowEstimator,
        model_error: AngleError = NO_ERROR,
    ) -> CalibrationOutcome:
        """See calibrator.SelfCalibrator."""
        used = self._in_use(estimator)
        self._know_origin(used)
        at = self._at(record)
        drifting, step = self._knowledge.now(used, at)
        found = self._mass_anchors(anchors, used)
        stated = self._knowledge.stated(used, Carried(drifting, step), at.total_kg)
        checks = self._checks(found, stated)
        drifting, step = unsure_of_gain(drifting, step, moisture_sd(reference for reference, _ in found))
        drifting, step = unsure_of_gain(drifting, step, model_error.home, all_along=True)
        prior = drifting.parameters
        found = [(reference, with_angle_error(mass, self._model, prior, model_error)) for reference, mass in found]
        try:
            masses, doubt = self._accepted(found, prior, stated)
        except ValueError as error:
            # A load that no parameters near these explain would be refused again with each mass that follows.
            self._used = frozenset(anchors)
            return CalibrationOutcome(None, f"{error}; the parameters stay", identifiable=False, weighed=True, checks=checks)
        if doubt and not masses:
            self._used = frozenset(anchors)
            return CalibrationOutcome(None, doubt, identifiable=False, weighed=True, checks=checks)
        if not masses:
            # Nothing was to be determined.
            return CalibrationOutcome(None, "no weighed mass that was measured whole; the parameters stay")
        self._given = None
        try:
            closed_loop, counted = self._settings.closed_loop, self._crops.current.counted
            update = LoadUpdate(self._model, closed_loop, self._load_settings, counted, self._origin)
            outcome, drifting = update.of(drifting, masses, {name_of(reference) for reference, _ in found})
        except ValueError as error:
            return CalibrationOutcome(None, f"{error}; the parameters stay", identifiable=False, checks=checks)
        if outcome.updated:
            found_set = outcome.parameter_set
            facts = {**used.provenance, **found_set.provenance, SCALE: WEIGHED}
            outcome = replace(outcome, parameter_set=replace(found_set, provenance=facts))
        taken = self._taken(outcome, Carried(drifting, step), used, at)
        self._used = frozenset(anchors)
        return replace(taken, reason=f"{taken.reason}; {doubt}" if doubt else taken.reason, weighed=True, checks=checks)

    def hear(self, record: WindowRecord, lesson: KernelLesson, estimator: FlowEstimator) -> CalibrationOutcome:
        """See calibrator.SelfCalibrator."""
        used = self._in_use(estimator)
        at = self._at(record)
        carried = self._knowledge.now(used, at)
        bias = self._knowledge.bias(used, carried.step, record.total_kg)
        if bias is None:
            if KERNEL_NOISE in used.provenance:
                reason = "what kernel noise taught these parameters is not known any more; it teaches again after a weighed load"
                return CalibrationOutcome(None, reason)
            bias = common_bias.begin(lesson.lasting_sd, len(carried.drifting.joint))
        if lesson.lasting_sd**2 > _WORSE * bias.largest:
            return CalibrationOutcome(None, "kernel noise is known worse than when it began to teach; the parameters stay")
        try:
            taught = common_bias.teach(self._model, carried.drifting, bias, lesson)
            refused = refusal(taught.drifting.parameters)
        except ValueError as error:
            return CalibrationOutcome(None, f"{error}; the parameters stay")
        if refused or abs(taught.difference) > _LESSON_SDS * taught.sd:
            off = f"kernel noise and mean force differ by {100.0 * taught.difference:+.0f} %"
            return CalibrationOutcome(None, f"{off}; {refused or 'the parameters stay'}")
        facts = {**used.provenance, KERNEL_NOISE: "taught"}
        known = replace(taught.drifting.parameters, version=used.version + 1, provenance=facts)
        self._given = None
        self._knowledge.take_kernel_lesson(taught, used, known, at, carried)
        self._replaced(used, at.time_s, known)
        self._last = known
        reason = (
            f"kernel noise moved the scale by {100.0 * taught.moved:+.1f} %; its bias is known to "
            f"{100.0 * taught.bias.variance**0.5:.1f} %"
        )
        return CalibrationOutcome(OpenLoop(self._model, known), reason)

    def follow(self, record: WindowRecord, estimator: FlowEstimator) -> CalibrationOutcome | None:
        """See calibrator.SelfCalibrator."""
        used = self._in_use(estimator)
        if not self._knowledge.has_drifted(used, record.total_kg):
            return None
        carried = self._knowledge.now(used, Instant(record.time_s, record.total_kg, nan))
        drifting = carried.drifting
        if refusal(drifting.parameters) and not refusal(used):
            return None
        still = ScaleReport(0.0, 0.0, 0.0, False, ())
        nothing = Outcome(drifting.parameters, False, True, "", "", (), (), still, 0.0, 0, 1.0, ())
        last, at = self.last, Instant(record.time_s, record.total_kg, self._knowledge.moisture_pct)
        taken = self._taken(nothing, carried, used, at)
        self.last = last
        return replace(taken, reason="moved by steady drift", moved_by_moisture=False)

    def drift_std_dev(self, record: WindowRecord, estimator: FlowEstimator) -> float:
        """See calibrator.SelfCalibrator."""
        used = self._in_use(estimator)
        self._knowledge.begin_counting(used, record.time_s, record.total_kg)
        if self._knowledge.is_new(used) and self._from_outside(used):
            self._knowledge.hold_from(record)
        return self._knowledge.deviation(self._model, used, record)

    def use(self, estimator: FlowEstimator, harvested_kg: float = 0.0) -> None:
        """See calibrator.SelfCalibrator."""
        before, used = self._last, self._in_use(estimator)
        self._knowledge.use(before, used, harvested_kg)

    def _from_outside(self, used: ParameterSet) -> bool:
        """Whether no lesson led to these parameters, and no undo brought them back."""
        before = any(dict(used.values) == dict(before.parameters.values) for before in self._history)
        return used is not self._updated and used is not self._restored and not before

    def sweep_worth(
        self, record: WindowRecord, stops_deg: Sequence[float], channels: OtherChannels, estimator: FlowEstimator
    ) -> SweepWorth | None:
        """See calibrator.SelfCalibrator. Drift counts from the first time that it is asked for, as from a first update."""
        used = self._in_use(estimator)
        if refusal(used) or not (record.mass_flow_kg_s > 0.0 and record.force_n > 0.0):
            return None
        drifting, step = self._knowledge.now(used, self._at(record))
        known, bias = drifting.parameters, self._knowledge.bias(used, step, record.total_kg)
        if bias is not None and isfinite(channels.kernels_sd):
            cross = tuple(float(v) for v in bias.cross[: len(known.covariance_names)])
            channels = replace(channels, kernels_sd=bias.variance**0.5, kernels_cross=cross)
        plan = SweepPlan(
            time_s=window_times_s(stops_deg),
            plate_angle_rad=np.radians(stops_deg),
            home_angle_rad=record.plate_angle_rad,
            elevator_speed_rad_s=record.elevator_speed_rad_s,
            mass_flow_kg_s=record.mass_flow_kg_s,
            noise_sd=record.force_std_dev_n / record.force_n,
            moisture_pct=record.moisture_pct,
        )
        try:
            return sweep_worth(self._model, known, plan, channels, allowing_for(self._settings.closed_loop, known))
        except ValueError:
            return None

    def _at(self, record: WindowRecord) -> Instant:
        moisture_pct = record.moisture_pct if self._settings.moisture_map is not None else nan
        return Instant(record.time_s, record.total_kg, moisture_pct)

    def _in_use(self, estimator: FlowEstimator) -> ParameterSet:
        """The parameters in use; with other effects than those before, another model explains them."""
        used = self._last = estimator.parameters
        if used.effects != self._model.effects:
            self._model = self._model.with_effects(used.effects)
        return used

    def _know_origin(self, used: ParameterSet) -> None:
        if used is not self._updated and used is not self._restored:
            self._origin, self._restored = used, None

    def _accepted(
        self, found: Sequence[tuple[ReferenceMass, MassAnchor]], prior: ParameterSet, stated: ParameterSet
    ) -> tuple[list[MassAnchor], str]:
        """The masses to update from, and one sentence about one that the loads before it contradict ("" where there is none)."""
        accepted, doubt = [], ""
        for reference, mass in found:
            error = self._crops.current.take(weighed(reference, mass), self._model, prior, stated)
            if error is None:
                accepted.append(mass)
            else:
                settings, counted = self._load_settings, self._crops.current.counted
                what = known_slip(self._model, prior, counted, weighed(reference, mass), settings)
                doubt = (
                    f"{name_of(reference)} contradicts the {len(counted)} weighed before it by {100.0 * error:+.1f} %"
                    f"{f', as if {what},' if what else ''} and counts for nothing until another agrees with it"
                )
        return accepted, doubt

    def _taken(
        self, outcome: Outcome, came: Carried, used: ParameterSet, at: Instant, *, sweep_alone: bool = False
    ) -> CalibrationOutcome:
        """The new parameters; came: the prior that the outcome began with."""
        self.last = outcome
        prior = Carried(*aligned(*came, outcome.parameter_set)) if outcome.updated else came
        before = prior.drifting.parameters
        if not outcome.updated and before.values == self._knowledge.patterned(used).values:
            return CalibrationOutcome(None, outcome.reason, identifiable=False)
        begun_s = self._knowledge.since_s
        known = self._knowledge.take(outcome, used, at, came, prior)
        self._replaced(used, at.time_s, known)
        self._last = known
        if known.effects != self._model.effects:
            self._model = self._model.with_effects(known.effects)
        return CalibrationOutcome(
            OpenLoop(self._model, known),
            outcome.reason if outcome.updated else "moved by moisture or steady drift; the data add too little",
            outcome.updated,
            step=self._step(outcome, used, begun_s, at.time_s, prior, sweep_alone=sweep_alone),
            moved_by_moisture=self._settings.moisture_map is not None,
        )

    def _step(
        self, outcome: Outcome, used: ParameterSet, begun_s: float, end_s: float, prior: Carried, *, sweep_alone: bool
    ) -> CalibrationStep | None:
        """How the lesson that was taken last led on from the parameters used before; None where states have changed."""
        now = self._knowledge.drifting
        names = now.parameters.covariance_names
        if now.state.shape != prior.step.after.shape or names != prior.drifting.parameters.covariance_names:
            return None
        widening = outcome.prior_widening if outcome.updated else 1.0
        state = tuple(map(float, now.state))
        return CalibrationStep(used.version, begun_s, end_s, prior.step, state, widening, sweep_alone, names)

    def _replaced(self, used: ParameterSet, until_s: float, known: ParameterSet) -> None:
        """Other parameters than those used until a bus time."""
        self._history = [*self._history[1 - _KEPT_SETS :], _Before(until_s, used, self._used)]
        self._updated = known

    def _without_sweeps(self, used: ParameterSet, now_s: float) -> CalibrationOutcome:
        """The model lacks something, so updates from sweeps were wrong: back to what was given, unless changed otherwise.

        With a moisture map the values given hold at another moisture, and those in use stay.
        """
        if self._given is None or self._given is used or self._settings.moisture_map is not None:
            return CalibrationOutcome(None, "the model disagrees with the sweeps; they change nothing")
        self._given = replace(self._given, version=used.version + 1)
        self._replaced(used, now_s, self._given)
        reason = "the model disagrees with the sweeps; what rests on them is undone"
        return CalibrationOutcome(OpenLoop(self._model.with_effects(self._given.effects), self._given), reason)

    @property
    def counted(self) -> frozenset[str]:
        """See calibrator.SelfCalibrator."""
        return self._crops.counted

    @property
    def doubted(self) -> frozenset[str]:
        """See calibrator.SelfCalibrator."""
        return self._crops.doubted

    def forget(
        self,
        load_numbers: frozenset[int],
        estimator: FlowEstimator,
        counted: Sequence[ReferenceMass] | None = None,
        scale: Sequence[ReferenceMass] = (),
    ) -> bool:
        """See calibrator.SelfCalibrator."""
        self._crops.forget({f"load {number}" for number in load_numbers})
        self._use_again({anchor for anchor in self._used | self._checked if anchor.load_number in load_numbers})
        if counted is None:
            return False
        used = self._in_use(estimator)
        handed = self._handed_before(used)
        if self._origin is not None:
            # Parameters from before an update come from where it came.
            self._updated, self._restored = None, used
        again = {mass for mass in scale if mass not in handed}
        self._use_again(again)
        left = sorted((*counted, *(mass for mass in scale if mass in handed)), key=lambda mass: mass.end_s)
        self._weigh_again([name_of(mass) for mass in left][-KEPT_LOADS:], "", left, used)
        return bool(again)

    def _use_again(self, masses: Collection[ReferenceMass]) -> None:
        """These teach and are held against what was counted as if they had not been handed over."""
        self._used, self._checked = self._used.difference(masses), self._checked.difference(masses)

    def _handed_before(self, restored: ParameterSet) -> frozenset[ReferenceMass]:
        """The masses that had been handed over when parameters were in use that an undo has brought back; by the oldest that are
        known where these are older."""
        now = () if self._updated is None else (_Before(inf, self._updated, self._used),)
        known: list[_Before] = [*self._history, *now]
        for before in reversed(known):
            same = dict(before.parameters.values) == dict(restored.values)
            if same and np.array_equal(before.parameters.covariance, restored.covariance):
                return before.handed
        return self._history[0].handed if self._history else self._used

    def change_grain(self, before: str, now: str, used: Sequence[ReferenceMass], estimator: FlowEstimator | None = None) -> None:
        """See calibrator.SelfCalibrator."""
        known, origin = self._updated or self._restored, None
        if self._origin is not None and known is not None:
            origin = as_prior_state(self._origin), as_prior_state(known)
        origin, state = self._crops.change(before, now, origin)
        self._origin, self._restored, self._updated = None, None, None
        if estimator is not None:
            back = self._in_use(estimator)
            if origin is not None and says_as(back, origin[1]):
                self._origin, self._restored = as_set(origin[0], back), back
            if state is not None:
                self._weigh_again(state.weighed, state.doubted, used, back)
        self._used = self._checked = frozenset(used)
        self._given = None

    def totals_reset(self, before_kg: float) -> None:
        """See calibrator.SelfCalibrator."""
        self._knowledge.totals_reset(before_kg)

    def snapshot(self, now_s: float, total_kg: float) -> CalibratorState | None:
        """See calibrator.SelfCalibrator."""
        state = self._knowledge.snapshot(now_s, total_kg)
        if state is None:
            return None
        return replace(
            state,
            weighed=tuple(load.name for load in self._crops.current.counted),
            doubted=self._crops.current.doubted_name,
            origin=self._kept_origin(),
            grains=self._crops.states(),
        )

    def _kept_origin(self) -> PriorState | None:
        origin, known = self._origin, self._updated or self._restored
        if origin is None or known is None or origin is known or LOAD_PATTERN in origin.effects:
            return None
        return replace(as_prior_state(origin), version=known.version)

    def restore(self, state: CalibratorState, parameters: ParameterSet, total_kg: float) -> None:
        """See calibrator.SelfCalibrator."""
        if state.origin is not None and state.origin.version == parameters.version:
            self._restored, self._origin = parameters, as_set(state.origin, parameters)
        self._before = state
        self._crops.restore(state.grains)
        self._knowledge.restore(state, parameters, total_kg)

    def remember(self, masses: Sequence[ReferenceMass], estimator: FlowEstimator) -> None:
        """See calibrator.SelfCalibrator."""
        self._used = self._checked = frozenset(masses)
        state, used = self._before, self._in_use(estimator)
        if state is None:
            return
        self._weigh_again(state.weighed, state.doubted, masses, used)

    def _weigh_again(self, names: Sequence[str], doubted: str, masses: Sequence[ReferenceMass], used: ParameterSet) -> None:
        """Go on with the loads of these names, that a run before counted, and the one that it doubted."""
        # Of two tickets for one load the newer counts.
        known = {name_of(anchor): anchor for anchor in masses}
        found = {
            name: weighed(anchor, self._mass_anchor(anchor, used)) for name, anchor in known.items() if name in (*names, doubted)
        }
        self._crops.current.restore([found[name] for name in names if name in found], found.get(doubted))

    def _checks(self, found: Sequence[tuple[ReferenceMass, MassAnchor]], stated: ParameterSet) -> tuple[ScaleCheck, ...]:
        """New masses held against what is stated now; each mass once, although a refused update may come again."""
        new = [pair for pair in found if pair[0] not in self._checked]
        self._checked = frozenset((*self._used, *(reference for reference, _ in found)))
        moisture_pct, model_error = self._knowledge.moisture_pct, self._settings.closed_loop.model_error
        checks = (checked(*pair, self._model, stated, moisture_pct=moisture_pct, model_error=model_error) for pair in new)
        return tuple(check for check in checks if check is not None)

    def _mass_anchors(self, anchors: Sequence[ReferenceMass], used: ParameterSet) -> list[tuple[ReferenceMass, MassAnchor]]:
        """Those that have not been used, each with the forces over it."""
        out = []
        for anchor in anchors:
            span_s = anchor.end_s - anchor.start_s
            if not anchor.complete or anchor in self._used or anchor.measured_kg <= 0.0 or span_s <= 0.0:
                continue
            out.append((anchor, self._mass_anchor(anchor, used)))
        return out

    def _mass_anchor(self, anchor: ReferenceMass, used: ParameterSet) -> MassAnchor:
        spans = (*((before.until_s, before.parameters) for before in self._history), (inf, used))
        patterned = ((until_s, self._knowledge.patterned(known)) for until_s, known in spans)
        return mass_anchor(anchor, self._model, patterned, self._settings.anchor_error)
