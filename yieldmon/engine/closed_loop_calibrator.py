"""Self-calibration for the monitor: sweeps and reference masses in, parameters out.

Between sweeps the parameters' covariance grows (drift), and moisture moves the prior; what a sweep or a weighed load changes is
`estimation.closed_loop`'s matter. Bus time comes with the records.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from yieldmon.engine.anchors import ReferenceMass
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.curve_states import aligned
from yieldmon.engine.drift_deviation import DriftDeviation, RateSpread, after_lesson, as_stated, force_deviation
from yieldmon.engine.learnt_before import Places, moved, place_of, remembered
from yieldmon.engine.load_update import LoadUpdate
from yieldmon.engine.mass_anchors import checked, mass_anchor, moisture_sd, weighed
from yieldmon.engine.prior_states import as_prior_state, as_set, as_tuples, says_as
from yieldmon.engine.records import (
    CalibrationOutcome,
    CalibrationStep,
    CalibratorState,
    FlowEstimator,
    GrainState,
    PriorState,
    WindowRecord,
)
from yieldmon.engine.scale_alarm import ScaleCheck, name_of
from yieldmon.engine.sweep_records import density_anchor, median_moisture_pct, sweep_of
from yieldmon.engine.weighings import KEPT_LOADS, Weighings
from yieldmon.estimation import common_bias, drift_spread
from yieldmon.estimation.admission import allowing_for, refusal
from yieldmon.estimation.angle_pattern import EFFECT, with_pattern
from yieldmon.estimation.closed_loop import self_calibrate, update_from_tickets
from yieldmon.estimation.closed_loop_inputs import MassAnchor
from yieldmon.estimation.closed_loop_outcome import Outcome, ScaleReport
from yieldmon.estimation.common_bias import CommonBias, KernelLesson
from yieldmon.estimation.load_inputs import LoadSettings
from yieldmon.estimation.load_pattern import EFFECT as LOAD_PATTERN
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.steady_drift import (
    Advance,
    DriftingParameters,
    advance,
    begin,
    carried,
    forgotten,
    learn,
    unsure_of_gain,
    widened,
)
from yieldmon.estimation.sweep_worth import OtherChannels, SweepPlan, SweepWorth, sweep_worth, window_times_s
from yieldmon.estimation.wrong_tickets import known_slip
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

_TAUGHT = "kernel_noise"
"""Key of the provenance of parameters that kernel noise has taught."""
_WORSE = 1.5
"""Of the bias's prior variance, the lasting one of a lesson beyond which it is not of that bias any more."""
_LESSON_SDS = 3.0
"""Deviations of a difference beyond which a lesson contradicts and teaches nothing."""
FOLLOWED_KG = 20_000.0
"""Of grain, after which a learnt steady drift moves the parameters without a lesson, and drift widens what is stated."""
_LEAST_FOLLOWED = 1e-5
"""Relative change of a parameter by steady drift below which it waits."""
_LEAST_LOAD_ERROR = 1e-4
"""Of a weighed load's measured mass."""


class _LearntAt(NamedTuple):
    """When, after how much grain in total, and of which moisture: what parameters have held from."""

    time_s: float
    total_kg: float
    moisture_pct: float


class ClosedLoopCalibrator:
    """A `records.SelfCalibrator`. Each reference mass is used once."""

    def __init__(self, model: ForwardModel, settings: CalibratorSettings | None = None) -> None:
        self._settings = CalibratorSettings() if settings is None else settings
        looks = self._settings.pattern_sd > 0.0 and EFFECT not in model.effects
        self._model = model.with_effects((*model.effects, EFFECT)) if looks else model
        self._map = self._settings.moisture_map
        self._moisture_pct = nan
        self._at_s = nan
        self._at_kg = nan
        self._used: frozenset[ReferenceMass] = frozenset()
        self._history: list[tuple[float, ParameterSet]] = []
        self._given: ParameterSet | None = None
        """As they came from outside, for as long as no reference mass has changed them since."""
        self._origin: ParameterSet | None = None
        """As they came from outside."""
        self._restored: ParameterSet | None = None
        """Those in use at a restart or at a crop's return, where it is known what weighed loads made them of."""
        self._updated: ParameterSet | None = None
        """The last set that was handed back."""
        self._drifting: DriftingParameters | None = None
        """The same with the rates of its drift."""
        self._waited_s = 0.0
        """Time since the last update before a restart."""
        self._before: CalibratorState | None = None
        """What was known before a restart."""
        self._load_settings = LoadSettings(load_error=max(self._settings.anchor_error, _LEAST_LOAD_ERROR))
        self._weighings = Weighings(self._load_settings)
        self._checked: frozenset[ReferenceMass] = frozenset()
        self._of_grain: dict[str, Weighings] = {}
        """Weighings of the crops before, by name."""
        self._origin_of_grain: dict[str, tuple[PriorState, PriorState]] = {}
        """Of the crops before, by name: parameters as they came from outside, and those that weighed loads made of them."""
        self._grains_before: dict[str, GrainState] = {}
        """Crops of a run before that have not been harvested since, by name."""
        self._bias: tuple[CommonBias, ParameterSet] | None = None
        """Of kernel noise, with the parameters that its covariance is with; None where it has taught none of these."""
        self._deviation: DriftDeviation | None = None
        self._spread: RateSpread | None = None
        self._last: ParameterSet | None = None
        """Those seen in use last."""
        self._past: Places = ()
        self._outside: tuple[ParameterSet, float] | None = None
        """Parameters from outside that no window has been measured with yet, and the grain, kg, since they were learnt."""
        self._placed: ParameterSet | None = None
        """Parameters in use that no lesson led to, of which it is known since when they hold."""
        self.last: Outcome | None = None

    def update(self, records: Sequence[WindowRecord], estimator: FlowEstimator, *, use_sweep: bool = True) -> CalibrationOutcome:
        """See records.SelfCalibrator."""
        if not records:
            return CalibrationOutcome(None, "the sweep has no usable window; the parameters stay", identifiable=False)
        now_s, total_kg = records[-1].time_s, records[-1].total_kg
        used = self._in_use(estimator)
        moisture_pct = median_moisture_pct(records)
        drifting, step = self._prior(used, moisture_pct, now_s, total_kg)
        prior = drifting.parameters
        density = density_anchor(records, prior, self._settings)
        if used is not self._updated:
            self._given = used
        self._know_origin(used)
        if density is not None:
            self._given = None
        if not use_sweep and density is None:
            return self._without_sweeps(used, now_s)
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
        at = _LearntAt(now_s, total_kg, moisture_pct)
        return self._taken(outcome, drifting, used, at, step, sweep_alone=density is None)

    def weigh(self, record: WindowRecord, anchors: Sequence[ReferenceMass], estimator: FlowEstimator) -> CalibrationOutcome:
        """See records.SelfCalibrator."""
        used = self._in_use(estimator)
        self._know_origin(used)
        at = self._learnt_at(record)
        drifting, step = self._prior(used, at.moisture_pct, at.time_s, at.total_kg)
        prior = drifting.parameters
        found = self._mass_anchors(anchors, used)
        stated = as_stated(prior, self._spread_at(used, drifting, step, at.total_kg))
        checks = self._checks(found, stated)
        drifting, step = unsure_of_gain(drifting, step, moisture_sd(reference for reference, _ in found))
        prior = drifting.parameters
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
            closed_loop, counted = self._settings.closed_loop, self._weighings.counted
            update = LoadUpdate(self._model, closed_loop, self._load_settings, counted, self._origin)
            outcome, drifting = update.of(drifting, masses, {name_of(reference) for reference, _ in found})
        except ValueError as error:
            return CalibrationOutcome(None, f"{error}; the parameters stay", identifiable=False, checks=checks)
        self._used = frozenset(anchors)
        taken = self._taken(outcome, drifting, used, at, step)
        return replace(taken, reason=f"{taken.reason}; {doubt}" if doubt else taken.reason, weighed=True, checks=checks)

    def hear(self, record: WindowRecord, lesson: KernelLesson, estimator: FlowEstimator) -> CalibrationOutcome:
        """See records.SelfCalibrator."""
        used = self._in_use(estimator)
        at = self._learnt_at(record)
        drifting, step = self._prior(used, at.moisture_pct, at.time_s, at.total_kg)
        bias = self._bias_of(used, step, record.total_kg)
        if bias is None:
            if _TAUGHT in used.provenance:
                reason = "what kernel noise taught these parameters is not known any more; it teaches again after a weighed load"
                return CalibrationOutcome(None, reason)
            bias = common_bias.begin(lesson.lasting_sd, len(drifting.joint))
        if lesson.lasting_sd**2 > _WORSE * bias.largest:
            return CalibrationOutcome(None, "kernel noise is known worse than when it began to teach; the parameters stay")
        try:
            taught = common_bias.teach(self._model, drifting, bias, lesson)
            refused = refusal(taught.drifting.parameters)
        except ValueError as error:
            return CalibrationOutcome(None, f"{error}; the parameters stay")
        if refused or abs(taught.difference) > _LESSON_SDS * taught.sd:
            off = f"kernel noise and mean force differ by {100.0 * taught.difference:+.0f} %"
            return CalibrationOutcome(None, f"{off}; {refused or 'the parameters stay'}")
        self._past = remembered(self._past, used, self._at_s, self._at_kg)
        facts = {**used.provenance, _TAUGHT: "taught"}
        known = replace(taught.drifting.parameters, version=used.version + 1, provenance=facts)
        self._given = None
        spread = drift_spread.taught(self._spread_at(used, drifting, step, at.total_kg), taught.errors)
        self._spread = RateSpread(spread, known)
        self._at_s, self._at_kg, self._moisture_pct = at
        self._history = [*self._history[-7:], (at.time_s, used)]
        self._updated = self._last = known
        self._drifting = replace(taught.drifting, parameters=known)
        self._bias = taught.bias, known
        reason = (
            f"kernel noise moved the scale by {100.0 * taught.moved:+.1f} %; its bias is known to "
            f"{100.0 * taught.bias.variance**0.5:.1f} %"
        )
        return CalibrationOutcome(OpenLoop(self._model, known), reason)

    def follow(self, record: WindowRecord, estimator: FlowEstimator) -> CalibrationOutcome | None:
        """See records.SelfCalibrator."""
        known = self._drifting
        if known is None or not record.total_kg - self._at_kg >= FOLLOWED_KG:
            return None
        used = self._in_use(estimator)
        grain_kt = (record.total_kg - self._at_kg) / 1e6
        if known.parameters is not used or not np.any(np.abs(known.rates) * grain_kt > _LEAST_FOLLOWED):
            return None
        drifting, step = self._prior(used, nan, record.time_s, record.total_kg)
        if refusal(drifting.parameters) and not refusal(used):
            return None
        still = ScaleReport(0.0, 0.0, 0.0, False, ())
        nothing = Outcome(drifting.parameters, False, True, "", "", (), (), still, 0.0, 0, 1.0, ())
        last, at = self.last, _LearntAt(record.time_s, record.total_kg, self._moisture_pct)
        taken = self._taken(nothing, drifting, used, at, step)
        self.last = last
        return replace(taken, reason="moved by steady drift", moved_by_moisture=False)

    def drift_std_dev(self, record: WindowRecord, estimator: FlowEstimator) -> float:
        """See records.SelfCalibrator."""
        used, seen = self._in_use(estimator), self._deviation
        self._place(used, record.time_s, record.total_kg)
        if not isfinite(self._at_kg):
            self._at_kg = record.total_kg
        if seen is not None and seen.parameters is not used and used is not self._placed and self._from_outside(used):
            # They describe the machine as it is now.
            self._at_s, self._at_kg = record.time_s, record.total_kg
        if seen is None or seen.parameters is not used:
            seen = DriftDeviation(0.0, used, -1)
        steps = int(max(record.total_kg - self._at_kg, 0.0) // FOLLOWED_KG)
        if seen.steps != steps and record.mass_flow_kg_s > 0.0:
            later = self._as_stated(used, record.time_s, record.total_kg) if steps else self._as_learnt(used)
            seen = DriftDeviation(force_deviation(self._model, used, later, record), used, steps)
        self._deviation = seen
        return seen.relative

    def use(self, estimator: FlowEstimator, harvested_kg: float = 0.0) -> None:
        """See records.SelfCalibrator."""
        if self._last is not None:
            self._past = remembered(self._past, self._last, self._at_s, self._at_kg)
        used = self._in_use(estimator)
        place = place_of(self._past, used)
        if place is None:
            self._outside = used, harvested_kg
            return
        self._outside, self._placed = None, used
        self._at_s, self._at_kg = place.at_s, place.at_kg

    def _place(self, used: ParameterSet, now_s: float, total_kg: float) -> None:
        """Parameters from outside begin to count with the first window."""
        if self._outside is not None and self._outside[0] is used:
            self._at_s, self._at_kg = now_s, total_kg - self._outside[1]
            self._placed = used
        self._outside = None

    def _as_stated(self, used: ParameterSet, time_s: float, total_kg: float) -> ParameterSet:
        """The parameters in use as far as they are known now, the size of steady rates being unknown."""
        later, step = self._prior(used, nan, time_s, total_kg)
        return as_stated(later.parameters, self._spread_at(used, later, step, total_kg))

    def _as_learnt(self, used: ParameterSet) -> ParameterSet:
        """The same as they were when they were learnt."""
        spread = self._spread
        return used if spread is None or spread.parameters is not used else as_stated(used, spread.covariance)

    def _spread_at(self, used: ParameterSet, later: DriftingParameters, step: Advance, total_kg: float) -> Array:
        """What rates of unknown size may have added until now; step: from the parameters in use to `later`."""
        start = self._drifting
        if start is None or start.parameters is not used:
            start = begin(self._patterned(used), self._settings.steady_per_kilotonne)
        gone = forgotten(
            start, max(total_kg - self._at_kg, 0.0),
            per_kilotonne=self._settings.steady_per_kilotonne, memory_kt=self._settings.steady_drift_memory_kt,
        )  # fmt: skip
        return RateSpread.at(self._spread, used, step, later, gone)

    def _from_outside(self, used: ParameterSet) -> bool:
        """Whether no lesson led to these parameters, and no undo brought them back."""
        before = any(dict(used.values) == dict(known.values) for _, known in self._history)
        return used is not self._updated and used is not self._restored and not before

    def sweep_worth(
        self, record: WindowRecord, stops_deg: Sequence[float], channels: OtherChannels, estimator: FlowEstimator
    ) -> SweepWorth | None:
        """See records.SelfCalibrator. Drift counts from the first time that it is asked for, as from a first update."""
        used = self._in_use(estimator)
        if refusal(used) or not (record.mass_flow_kg_s > 0.0 and record.force_n > 0.0):
            return None
        drifting, step = self._prior(used, record.moisture_pct, record.time_s, record.total_kg)
        known, bias = drifting.parameters, self._bias_of(used, step, record.total_kg)
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

    def _learnt_at(self, record: WindowRecord) -> _LearntAt:
        return _LearntAt(record.time_s, record.total_kg, record.moisture_pct if self._map is not None else nan)

    def _bias_of(self, used: ParameterSet, step: Advance, total_kg: float) -> CommonBias | None:
        """The bias as it is now; None where its covariance with these parameters is not known."""
        if self._bias is None or self._bias[1] is not used or len(self._bias[0].cross) != len(step.transition):
            return None
        return common_bias.carried(self._bias[0], step.transition, total_kg - self._at_kg)

    def _in_use(self, estimator: FlowEstimator) -> ParameterSet:
        """The parameters in use; with other effects than those before, another model explains them."""
        used = self._last = estimator.parameters
        if used.effects != self._model.effects:
            self._model = self._model.with_effects(used.effects)
        return used

    def _patterned(self, parameters: ParameterSet) -> ParameterSet:
        return with_pattern(parameters, self._settings.pattern_sd) if self._settings.pattern_sd > 0.0 else parameters

    def _know_origin(self, used: ParameterSet) -> None:
        if used is not self._updated and used is not self._restored:
            self._origin, self._restored = used, None

    def _accepted(
        self, found: Sequence[tuple[ReferenceMass, MassAnchor]], prior: ParameterSet, stated: ParameterSet
    ) -> tuple[list[MassAnchor], str]:
        """The masses to update from, and one sentence about one that the loads before it contradict ("" where there is none)."""
        accepted, doubt = [], ""
        for reference, mass in found:
            error = self._weighings.take(weighed(reference, mass), self._model, prior, stated)
            if error is None:
                accepted.append(mass)
            else:
                settings, counted = self._load_settings, self._weighings.counted
                what = known_slip(self._model, prior, counted, weighed(reference, mass), settings)
                doubt = (
                    f"{name_of(reference)} contradicts the {len(counted)} weighed before it by {100.0 * error:+.1f} %"
                    f"{f', as if {what},' if what else ''} and counts for nothing until another agrees with it"
                )
        return accepted, doubt

    def _taken(
        self,
        outcome: Outcome,
        drifting: DriftingParameters,
        used: ParameterSet,
        at: _LearntAt,
        step: Advance,
        *,
        sweep_alone: bool = False,
    ) -> CalibrationOutcome:
        """The new parameters, remembered with what they hold from; step led to it."""
        self.last = outcome
        came, known_before = step, drifting
        if outcome.updated:
            drifting, step = aligned(drifting, step, outcome.parameter_set)
        prior = drifting.parameters
        if not outcome.updated and prior.values == self._patterned(used).values:
            return CalibrationOutcome(None, outcome.reason, identifiable=False)
        # Without an update the moisture map or the drift alone has moved the values; the new prior is what is known.
        bias = self._bias_of(used, came, at.total_kg) if drifting is known_before else None
        begun_s = self._at_s
        self._past = remembered(self._past, used, self._at_s, self._at_kg)
        whole = known_before.joint.shape == came.covariance_after.shape
        spread = self._spread_at(used, known_before, came, at.total_kg) if whole else None
        self._at_s, self._at_kg, self._moisture_pct = at
        self._history = [*self._history[-7:], (at.time_s, used)]
        if outcome.updated and outcome.parameter_set.covariance_names != drifting.parameters.covariance_names:
            self._drifting = begin(outcome.parameter_set, self._settings.steady_per_kilotonne)
        elif outcome.updated:
            self._drifting = learn(drifting, outcome.parameter_set, widening=outcome.prior_widening)
        else:
            self._drifting = carried(drifting, replace(prior, version=used.version + 1))
        known = self._drifting.parameters
        same = self._drifting.joint.shape == drifting.joint.shape and known.covariance_names == prior.covariance_names
        heard = bias
        if bias is not None and same and outcome.updated:
            bias = common_bias.followed(bias, drifting, self._drifting, widening=outcome.prior_widening)
        if spread is not None and outcome.updated:
            before = widened(drifting.joint, len(prior.covariance_names), outcome.prior_widening)
            spread = after_lesson(spread, before, self._drifting, (heard, bias if same else None))
        if (bias is None or not same) and outcome.scale.observable and _TAUGHT in known.provenance:
            # What kernel noise taught is not known any more, and no longer matters.
            known = replace(known, provenance={key: text for key, text in known.provenance.items() if key != _TAUGHT})
            self._drifting = replace(self._drifting, parameters=known)
        self._bias = (bias, known) if bias is not None and same else None
        self._spread = None if spread is None else RateSpread(spread, known)
        reason = outcome.reason if outcome.updated else "moved by moisture or steady drift; the data add too little"
        self._updated = self._last = known
        if known.effects != self._model.effects:
            self._model = self._model.with_effects(known.effects)
        follows = self._drifting.state.shape == step.after.shape and known.covariance_names == prior.covariance_names
        state = tuple(map(float, self._drifting.state))
        widening = outcome.prior_widening if outcome.updated else 1.0
        led = CalibrationStep(used.version, begun_s, at.time_s, step, state, widening, sweep_alone, known.covariance_names)
        moved = self._map is not None
        step_taken = led if follows else None
        return CalibrationOutcome(OpenLoop(self._model, known), reason, outcome.updated, step=step_taken, moved_by_moisture=moved)

    def _without_sweeps(self, used: ParameterSet, now_s: float) -> CalibrationOutcome:
        """The model lacks something, so updates from sweeps were wrong: back to what was given, unless changed otherwise.

        With a moisture map the values given hold at another moisture, and those in use stay.
        """
        if self._given is None or self._given is used or self._map is not None:
            return CalibrationOutcome(None, "the model disagrees with the sweeps; they change nothing")
        self._history = [*self._history[-7:], (now_s, used)]
        self._updated = self._given = replace(self._given, version=used.version + 1)
        reason = "the model disagrees with the sweeps; what rests on them is undone"
        return CalibrationOutcome(OpenLoop(self._model.with_effects(self._updated.effects), self._updated), reason)

    @property
    def counted(self) -> frozenset[str]:
        """See records.SelfCalibrator."""
        known = (self._weighings, *self._of_grain.values())
        before = (name for grain in self._grains_before.values() for name in grain.weighed)
        return frozenset((*(load.name for weighings in known for load in weighings.counted), *before))

    def forget(
        self, load_numbers: frozenset[int], estimator: FlowEstimator, counted: Sequence[ReferenceMass] | None = None
    ) -> None:
        """See records.SelfCalibrator."""
        names = {f"load {number}" for number in load_numbers}
        for weighings in (self._weighings, *self._of_grain.values()):
            weighings.forget(names)
        for crop, grain in self._grains_before.items():
            left = tuple(name for name in grain.weighed if name not in names)
            self._grains_before[crop] = replace(grain, weighed=left, doubted="" if grain.doubted in names else grain.doubted)
        self._used = frozenset(anchor for anchor in self._used if anchor.load_number not in load_numbers)
        if counted is None:
            return
        used = self._in_use(estimator)
        if self._origin is not None:
            # Parameters from before an update come from where it came.
            self._updated, self._restored = None, used
        self._weigh_again([name_of(anchor) for anchor in counted][-KEPT_LOADS:], "", counted, used)

    def change_grain(self, before: str, now: str, used: Sequence[ReferenceMass], estimator: FlowEstimator | None = None) -> None:
        """See records.SelfCalibrator."""
        known = self._updated or self._restored
        if self._origin is not None and known is not None:
            self._origin_of_grain[before] = as_prior_state(self._origin), as_prior_state(known)
        self._origin, self._restored, self._updated = None, None, None
        kept = self._grains_before.pop(now, None)
        origin, left = self._origin_of_grain.pop(now, (None, None) if kept is None else (kept.origin, kept.left))
        self._of_grain[before] = self._weighings
        self._weighings = self._of_grain.pop(now, Weighings(self._load_settings))
        if estimator is not None:
            back = self._in_use(estimator)
            if origin is not None and left is not None and says_as(back, left):
                self._origin, self._restored = as_set(origin, back), back
            if kept is not None:
                self._weigh_again(kept.weighed, kept.doubted, used, back)
        self._used = self._checked = frozenset(used)
        self._given = None

    def totals_reset(self, before_kg: float) -> None:
        """See records.SelfCalibrator."""
        self._at_kg -= before_kg
        self._past = moved(self._past, -before_kg)

    def snapshot(self, now_s: float, total_kg: float) -> CalibratorState | None:
        """See records.SelfCalibrator."""
        if not isfinite(self._at_kg):
            return None
        known = self._drifting
        count = 0 if known is None else len(known.parameters.covariance_names)
        return CalibratorState(
            waited_s=max(now_s - self._at_s, 0.0) if isfinite(self._at_s) else self._waited_s,
            harvested_kg=max(total_kg - self._at_kg, 0.0),
            moisture_pct=self._moisture_pct if isfinite(self._moisture_pct) else None,
            drifting=() if known is None else known.names,
            rates=() if known is None else tuple(map(float, known.rates)),
            covariance=() if known is None else as_tuples(known.joint[count:]),
            at_s=self._at_s if isfinite(self._at_s) else self._before.at_s if self._before is not None else None,
            weighed=tuple(load.name for load in self._weighings.counted),
            doubted=self._weighings.doubted_name,
            bias=self._kept_bias(),
            spread=self._kept_spread(),
            origin=self._kept_origin(),
            grains=self._kept_grains(),
            past=self._past,
        )

    def _kept_bias(self) -> tuple[float, ...]:
        if self._bias is None or self._drifting is None or self._bias[1] is not self._drifting.parameters:
            return ()
        bias = self._bias[0]
        return (bias.value, bias.variance, bias.largest, *map(float, bias.cross))

    def _kept_spread(self) -> tuple[tuple[float, ...], ...]:
        if self._spread is None or self._drifting is None or self._spread.parameters is not self._drifting.parameters:
            return ()
        return as_tuples(self._spread.covariance)

    def _kept_origin(self) -> PriorState | None:
        origin, known = self._origin, self._updated or self._restored
        if origin is None or known is None or origin is known or LOAD_PATTERN in origin.effects:
            return None
        return replace(as_prior_state(origin), version=known.version)

    def _kept_grains(self) -> tuple[GrainState, ...]:
        found = dict(self._grains_before)
        for crop, weighings in self._of_grain.items():
            names = tuple(load.name for load in weighings.counted)
            origin, left = self._origin_of_grain.get(crop, (None, None))
            if not names and not weighings.doubted_name and origin is None:
                continue
            found[crop] = GrainState(crop, names, weighings.doubted_name, origin, left)
        return tuple(found.values())

    def restore(self, state: CalibratorState, parameters: ParameterSet, total_kg: float) -> None:
        """See records.SelfCalibrator."""
        if state.origin is not None and state.origin.version == parameters.version:
            self._restored, self._origin = parameters, as_set(state.origin, parameters)
        self._before, self._past, self._outside, self._placed = state, state.past, None, parameters
        self._grains_before = {grain.crop: grain for grain in state.grains}
        self._waited_s, self._at_kg = state.waited_s, total_kg - state.harvested_kg
        self._moisture_pct = nan if state.moisture_pct is None else state.moisture_pct
        fresh = begin(parameters, self._settings.steady_per_kilotonne)
        if len(state.bias) == 3 + len(fresh.joint) and fresh.parameters is parameters:
            value, variance, largest, *cross = state.bias
            self._bias = CommonBias(value, variance, np.array(cross), largest), parameters
        if len(state.spread) == 1 + len(fresh.joint) and fresh.parameters is parameters:
            self._spread = RateSpread(np.array(state.spread), parameters)
        if not state.drifting or fresh.names != state.drifting or len(state.covariance[0]) != len(fresh.joint):
            return  # No rates, or others by now: they begin anew.
        rows, joint = np.array(state.covariance), fresh.joint.copy()
        joint[-len(rows) :, :] = rows
        joint[:, -len(rows) :] = rows.T
        self._drifting = replace(fresh, rates=np.array(state.rates), joint=joint)

    def remember(self, masses: Sequence[ReferenceMass], estimator: FlowEstimator) -> None:
        """See records.SelfCalibrator."""
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
        self._weighings.restore([found[name] for name in names if name in found], found.get(doubted))

    def _prior(
        self, used: ParameterSet, moisture_pct: float, now_s: float, total_kg: float
    ) -> tuple[DriftingParameters, Advance]:
        """What is known now: the parameters in use, moved by moisture and steady rates, widened by what wanders; and how."""
        known = self._drifting
        if known is None or known.parameters is not used:
            known = begin(self._patterned(used), self._settings.steady_per_kilotonne)
        start = known
        self._place(used, now_s, total_kg)
        if self._map is not None and isfinite(moisture_pct):
            if isfinite(self._moisture_pct):
                known = carried(known, self._map.moved(known.parameters, self._moisture_pct, moisture_pct))
            else:
                self._moisture_pct = moisture_pct
        if not isfinite(self._at_s):
            at_s = self._before.at_s if self._before is not None else None
            # A bus time that began anew says nothing of the time between.
            self._at_s = at_s if at_s is not None and at_s <= now_s else now_s - self._waited_s
        if not isfinite(self._at_kg):
            self._at_kg = total_kg
        hours = max(now_s - self._at_s, 0.0) / 3600.0
        later, step = advance(
            known, self._settings.drift, hours, max(total_kg - self._at_kg, 0.0),
            per_kilotonne=self._settings.steady_per_kilotonne, memory_kt=self._settings.steady_drift_memory_kt,
        )  # fmt: skip
        before, moved = start.state, known.state
        carry = np.divide(moved, before, out=np.ones_like(moved), where=before != 0.0)
        return later, replace(
            step,
            before=before,
            covariance_before=start.joint,
            transition=step.transition * carry,
        )

    def _checks(self, found: Sequence[tuple[ReferenceMass, MassAnchor]], stated: ParameterSet) -> tuple[ScaleCheck, ...]:
        """New masses held against what is stated now; each mass once, although a refused update may come again."""
        new = [pair for pair in found if pair[0] not in self._checked]
        self._checked = frozenset((*self._used, *(reference for reference, _ in found)))
        model_error = self._settings.closed_loop.model_error
        checks = (checked(*p, self._model, stated, moisture_pct=self._moisture_pct, model_error=model_error) for p in new)
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
        spans = ((until_s, self._patterned(known)) for until_s, known in (*self._history, (float("inf"), used)))
        return mass_anchor(anchor, self._model, spans, self._settings.anchor_error)
