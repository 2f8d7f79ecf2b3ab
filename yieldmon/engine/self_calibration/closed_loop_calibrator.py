"""Self-calibration for the monitor: sweeps and reference masses in, parameters out.

Between sweeps the parameters' covariance grows (drift), and moisture moves the prior; updates by a sweep or a weighed load are
made by `estimation.self_calibration.closed_loop`. Bus time comes with the records.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, isfinite, nan

import numpy as np

from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome, CalibrationStep
from yieldmon.engine.self_calibration.calibrator_state import CalibratorState
from yieldmon.engine.self_calibration.curve_states import aligned
from yieldmon.engine.self_calibration.held_since import Instant
from yieldmon.engine.self_calibration.load_update import LoadUpdate
from yieldmon.engine.self_calibration.parameter_knowledge import KERNEL_NOISE, Carried, ParameterKnowledge
from yieldmon.engine.self_calibration.parameter_lineage import ParameterLineage
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.self_calibration.reference_mass_inputs import moisture_sd, with_angle_error
from yieldmon.engine.self_calibration.scale_alarm import name_of
from yieldmon.engine.self_calibration.weighed_masses import Spans, WeighedMasses
from yieldmon.engine.sweeps.sweep_records import measured_density, median_moisture_pct, sweep_of
from yieldmon.estimation.admission import allowing_for, refusal, sweep_refusal
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import BY_KERNELS, CARRIED_FROM, SCALE, WEIGHED, ParameterSet
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError
from yieldmon.estimation.self_calibration.angle_pattern import EFFECT
from yieldmon.estimation.self_calibration.closed_loop import fit_parameters, update_from_tickets
from yieldmon.estimation.self_calibration.closed_loop_outcome import Outcome
from yieldmon.estimation.self_calibration.steady_drift import with_gain_error
from yieldmon.estimation.self_calibration.sweep_worth import OtherChannels, SweepPlan, SweepWorth, sweep_worth, window_times_s
from yieldmon.estimation.waveform import common_bias
from yieldmon.estimation.waveform.common_bias import KernelMeasurement
from yieldmon.physics.model import ForwardModel

_WORSE = 1.5
"""Largest ratio of a measurement's lasting variance to the bias's largest variance, for the bias to count as the same."""
_CONTRADICTION_SDS = 3.0
"""Standard deviations of a difference beyond which kernel noise contradicts the mean force and updates nothing."""


class ClosedLoopCalibrator:
    """A `calibrator.SelfCalibrator`. Each reference mass is used once."""

    def __init__(self, model: ForwardModel, settings: CalibratorSettings | None = None) -> None:
        self._settings = CalibratorSettings() if settings is None else settings
        looks = self._settings.pattern_sd > 0.0 and EFFECT not in model.effects
        self._model = model.with_effects((*model.effects, EFFECT)) if looks else model
        self._knowledge = ParameterKnowledge(self._settings)
        self._lineage = ParameterLineage()
        self._masses = WeighedMasses(self._settings.reference_error)
        self._model_error = NO_ERROR
        """Model error by which the forces over weighed masses were last corrected."""
        self._before: CalibratorState | None = None
        """State before a restart."""
        self.last: Outcome | None = None
        """Outcome of the last sweep or weighed mass that was used."""

    def update(self, records: Sequence[WindowRecord], estimator: FlowEstimator, *, use_sweep: bool = True) -> CalibrationOutcome:
        """See calibrator.SelfCalibrator."""
        if not records:
            return CalibrationOutcome(None, "the sweep has no usable window; the parameters stay", identifiable=False)
        used = self._in_use(estimator)
        at = Instant(records[-1].time_s, records[-1].total_kg, median_moisture_pct(records))
        carried = self._knowledge.now(used, at)
        prior = carried.drifting.parameters
        density = measured_density(records, prior, self._settings)
        self._lineage.swept(used)
        if density is not None:
            self._lineage.forget_given()
        if not use_sweep and density is None:
            return self._without_sweeps(used, at.time_s)
        refused = sweep_refusal(used)
        if refused and density is None:
            return CalibrationOutcome(None, refused, identifiable=False)
        try:
            sweeps = [sweep_of(records)] if use_sweep and not refused else []
            settings = allowing_for(self._settings.closed_loop, prior)
            outcome = fit_parameters(self._model, prior, sweeps, density=density, settings=settings)
            leads = refusal(outcome.parameter_set) if sweeps and outcome.updated else ""
            if (leads or not outcome.consistent) and density is not None:
                outcome = update_from_tickets(self._model, prior, (), density, self._settings.closed_loop)
            elif leads:
                return CalibrationOutcome(None, f"the sweep would put {leads}", identifiable=False)
        except ValueError as error:
            return CalibrationOutcome(None, f"{error}; the parameters stay", identifiable=False)
        self.last = outcome
        return self._taken(outcome, carried, used, at, sweep_alone=density is None)

    def weigh(
        self,
        record: WindowRecord,
        references: Sequence[ReferenceMass],
        estimator: FlowEstimator,
        model_error: AngleError = NO_ERROR,
    ) -> CalibrationOutcome:
        """See calibrator.SelfCalibrator."""
        used = self._in_use(estimator)
        self._lineage.weighed(used)
        self._model_error = model_error
        found = self._masses.new(references, self._model, self._spans(used), model_error)
        at = self._weighed_at(self._at(record), used, [reference.end_s for reference, _ in found])
        drifting, step = self._knowledge.now(used, at)
        stated = self._knowledge.stated(used, Carried(drifting, step), at.total_kg)
        checks = self._masses.checks(
            found,
            self._model,
            stated,
            moisture_pct=self._knowledge.moisture_pct,
            model_error=self._settings.closed_loop.model_error,
        )
        drifting, step = with_gain_error(drifting, step, moisture_sd(reference for reference, _ in found))
        drifting, step = with_gain_error(drifting, step, hypot(model_error.home, used.scale_error), all_along=True)
        prior = drifting.parameters
        found = [(reference, with_angle_error(mass, self._model, prior, model_error)) for reference, mass in found]
        try:
            masses, doubt = self._masses.take(found, self._model, prior, stated)
        except ValueError as error:
            # Handed over all the same: otherwise the load would be refused again with each later mass.
            self._masses.handed_over(references)
            return CalibrationOutcome(None, f"{error}; the parameters stay", identifiable=False, weighed=True, checks=checks)
        if doubt and not masses:
            self._masses.handed_over(references)
            return CalibrationOutcome(None, doubt, identifiable=False, weighed=True, checks=checks)
        if not masses:
            # Nothing was to be determined.
            return CalibrationOutcome(None, "no weighed mass that was measured whole; the parameters stay")
        self._lineage.forget_given()
        try:
            closed_loop, counted = self._settings.closed_loop, self._masses.crops.current.counted
            origin = self._lineage.origin
            origin = origin if origin is None else self._knowledge.patterned(origin)
            update = LoadUpdate(self._model, closed_loop, self._masses.settings, counted, origin)
            outcome, drifting = update.of(drifting, masses, {name_of(reference) for reference, _ in found})
        except ValueError as error:
            return CalibrationOutcome(None, f"{error}; the parameters stay", identifiable=False, checks=checks)
        if outcome.updated:
            found_set = outcome.parameter_set
            facts = {**used.provenance, **found_set.provenance, SCALE: WEIGHED}
            facts.pop(CARRIED_FROM, None)
            outcome = replace(outcome, parameter_set=replace(found_set, provenance=facts))
        self.last = outcome
        taken = self._taken(outcome, Carried(drifting, step), used, at, now_s=record.time_s)
        self._masses.handed_over(references)
        return replace(taken, reason=f"{taken.reason}; {doubt}" if doubt else taken.reason, weighed=True, checks=checks)

    def update_from_kernels(
        self, record: WindowRecord, measurement: KernelMeasurement, estimator: FlowEstimator
    ) -> CalibrationOutcome:
        """See calibrator.SelfCalibrator."""
        used = self._in_use(estimator)
        at = self._at(record)
        carried = Carried(*with_gain_error(*self._knowledge.now(used, at), used.scale_error, all_along=True))
        bias = self._knowledge.bias(used, carried.step, record.total_kg)
        if bias is None:
            if KERNEL_NOISE in used.provenance:
                reason = "how kernel noise updated these parameters is not known any more; it does so again after a weighed load"
                return CalibrationOutcome(None, reason)
            bias = common_bias.begin(measurement.lasting_sd, len(carried.drifting.joint))
        if measurement.lasting_sd**2 > _WORSE * bias.largest:
            return CalibrationOutcome(None, "kernel noise is known worse than at its first update; the parameters stay")
        try:
            updated = common_bias.update(self._model, carried.drifting, bias, measurement)
            refused = refusal(updated.drifting.parameters)
        except ValueError as error:
            return CalibrationOutcome(None, f"{error}; the parameters stay")
        if refused or abs(updated.difference) > _CONTRADICTION_SDS * updated.sd:
            off = f"kernel noise and mean force differ by {100.0 * updated.difference:+.0f} %"
            return CalibrationOutcome(None, f"{off}; {refused or 'the parameters stay'}")
        facts = {**used.provenance, KERNEL_NOISE: "updated"}
        if used.scale_error > 0.0:
            facts[SCALE] = BY_KERNELS
            facts.pop(CARRIED_FROM, None)
        known = replace(updated.drifting.parameters, version=used.version + 1, provenance=facts)
        self._lineage.forget_given()
        self._knowledge.take_kernel_update(updated, used, known, at, carried)
        self._replaced(used, at.time_s, known)
        reason = (
            f"kernel noise moved the scale by {100.0 * updated.moved:+.1f} %; its bias is known to "
            f"{100.0 * updated.bias.variance**0.5:.1f} %"
        )
        if facts.get(SCALE) == BY_KERNELS:
            reason += "; no weighed load confirms the kernel weight on which it rests"
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
        at = Instant(record.time_s, record.total_kg, self._knowledge.moisture_pct)
        taken = self._taken(Outcome.unchanged(drifting.parameters), carried, used, at)
        return replace(taken, reason="moved by steady drift", moved_by_moisture=False)

    def drift_std_dev(self, record: WindowRecord, estimator: FlowEstimator) -> float:
        """See calibrator.SelfCalibrator."""
        used = self._in_use(estimator)
        self._knowledge.begin_counting(used, record.time_s, record.total_kg)
        if self._knowledge.is_new(used) and self._lineage.from_outside(used):
            self._knowledge.hold_from(record)
        model = self._model if self._model.effects == used.effects else self._model.with_effects(used.effects)
        return self._knowledge.deviation(model, used, record)

    def use(self, estimator: FlowEstimator, harvested_kg: float = 0.0) -> None:
        """See calibrator.SelfCalibrator."""
        before, used = self._lineage.last, self._in_use(estimator)
        self._knowledge.use(before, used, harvested_kg)

    def sweep_worth(
        self, record: WindowRecord, stops_deg: Sequence[float], channels: OtherChannels, estimator: FlowEstimator
    ) -> SweepWorth | None:
        """See calibrator.SelfCalibrator. Drift counts from the first time that it is asked for, as from a first update."""
        used = self._in_use(estimator)
        if sweep_refusal(used) or not (record.mass_flow_kg_s > 0.0 and record.force_n > 0.0):
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

    def _weighed_at(self, now: Instant, used: ParameterSet, ends_s: Sequence[float]) -> Instant:
        """The instant that masses measure: when their grain had passed, not when they were entered, which may be a night later;
        but not before the last update."""
        self._knowledge.now(used, now)
        last_s = max((end_s for end_s in ends_s if isfinite(end_s)), default=now.time_s)
        return now._replace(time_s=min(max(last_s, self._knowledge.since_s), now.time_s))

    def _in_use(self, estimator: FlowEstimator) -> ParameterSet:
        """The parameters in use; with other effects than those before, another model explains them."""
        used = estimator.parameters
        self._lineage.seen(used)
        effects = self._knowledge.patterned(used).effects
        if effects != self._model.effects:
            self._model = self._model.with_effects(effects)
        return used

    def _taken(
        self, outcome: Outcome, came: Carried, used: ParameterSet, at: Instant, *, sweep_alone: bool = False, now_s: float = nan
    ) -> CalibrationOutcome:
        """Take an outcome over; came: the prior it began with; now_s: bus time of the change where the masses are of earlier
        grain."""
        prior = Carried(*aligned(*came, outcome.parameter_set)) if outcome.updated else came
        before = prior.drifting.parameters
        if not outcome.updated and before.values == self._knowledge.patterned(used).values:
            return CalibrationOutcome(None, outcome.reason, identifiable=False)
        begun_s = self._knowledge.since_s
        known = self._knowledge.take(outcome, used, at, came, prior)
        self._replaced(used, now_s if isfinite(now_s) else at.time_s, known)
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
        """The step of the last update from the parameters used before; None where the states have other sizes or names."""
        now = self._knowledge.drifting
        names = now.parameters.covariance_names
        if now.state.shape != prior.step.after.shape or names != prior.drifting.parameters.covariance_names:
            return None
        widening = outcome.prior_widening if outcome.updated else 1.0
        state = tuple(map(float, now.state))
        return CalibrationStep(
            from_version=used.version,
            begin_s=begun_s,
            end_s=end_s,
            advance=prior.step,
            state=state,
            widening=widening,
            sweep_alone=sweep_alone,
            names=names,
        )

    def _replaced(self, used: ParameterSet, until_s: float, known: ParameterSet) -> None:
        """Note that `known` replaces the parameters used until a bus time."""
        self._lineage.replaced(used, until_s, known, self._masses.used)
        self._lineage.seen(known)

    def _without_sweeps(self, used: ParameterSet, now_s: float) -> CalibrationOutcome:
        """Undo the updates by sweeps, which were wrong because the model lacks an effect, unless another update came since.

        With a moisture map the given values hold at another moisture, so the values in use stay.
        """
        mapped = self._settings.moisture_map is not None
        given = None if mapped else self._lineage.undo_sweeps(used, now_s, self._masses.used)
        if given is None:
            return CalibrationOutcome(None, "the model disagrees with the sweeps; they change nothing")
        reason = "the model disagrees with the sweeps; what rests on them is undone"
        return CalibrationOutcome(OpenLoop(self._model.with_effects(given.effects), given), reason)

    def _spans(self, used: ParameterSet) -> Spans:
        return tuple((until_s, self._knowledge.patterned(known)) for until_s, known in self._lineage.spans(used))

    @property
    def counted(self) -> frozenset[str]:
        """See calibrator.SelfCalibrator."""
        return self._masses.crops.counted

    @property
    def doubted(self) -> frozenset[str]:
        """See calibrator.SelfCalibrator."""
        return self._masses.crops.doubted

    def forget(
        self,
        load_numbers: frozenset[int],
        estimator: FlowEstimator,
        counted: Sequence[ReferenceMass] | None = None,
        scale: Sequence[ReferenceMass] = (),
    ) -> bool:
        """See calibrator.SelfCalibrator."""
        self._masses.forget(load_numbers)
        if counted is None:
            return False
        used = self._in_use(estimator)
        handed = self._lineage.handed_before(used, self._masses.used)
        self._lineage.brought_back(used)
        again = {mass for mass in scale if mass not in handed}
        self._masses.use_again(again)
        left = (*counted, *(mass for mass in scale if mass in handed))
        self._masses.rests_on(left)
        self._masses.go_on_with(left, self._model, self._spans(used), self._model_error)
        return bool(again)

    def change_grain(self, before: str, now: str, used: Sequence[ReferenceMass], estimator: FlowEstimator | None = None) -> None:
        """See calibrator.SelfCalibrator."""
        origin, state = self._masses.crops.change(before, now, self._lineage.leave_crop())
        if estimator is not None:
            back = self._in_use(estimator)
            self._lineage.return_to_crop(origin, back)
            if state is not None:
                weighed = state.weighed, state.doubted, used
                self._masses.weigh_again(*weighed, self._model, self._spans(back), self._model_error)
        self._masses.remember(used)

    def totals_reset(self, before_kg: float) -> None:
        """See calibrator.SelfCalibrator."""
        self._knowledge.totals_reset(before_kg)

    def snapshot(self, now_s: float, total_kg: float) -> CalibratorState | None:
        """See calibrator.SelfCalibrator."""
        state = self._knowledge.snapshot(now_s, total_kg)
        if state is None:
            return None
        current = self._masses.crops.current
        return replace(
            state,
            weighed=tuple(load.name for load in current.counted),
            doubted=current.doubted_name,
            origin=self._lineage.snapshot(),
            grains=self._masses.crops.states(),
        )

    def restore(self, state: CalibratorState, parameters: ParameterSet, total_kg: float) -> None:
        """See calibrator.SelfCalibrator."""
        self._lineage.restore(state.origin, parameters)
        self._before = state
        self._masses.crops.restore(state.grains)
        self._knowledge.restore(state, parameters, total_kg)

    def remember(self, masses: Sequence[ReferenceMass], estimator: FlowEstimator, model_error: AngleError = NO_ERROR) -> None:
        """See calibrator.SelfCalibrator."""
        self._masses.remember(masses)
        self._model_error = model_error
        state, used = self._before, self._in_use(estimator)
        if state is not None:
            weighed = state.weighed, state.doubted, masses
            self._masses.weigh_again(*weighed, self._model, self._spans(used), model_error)
