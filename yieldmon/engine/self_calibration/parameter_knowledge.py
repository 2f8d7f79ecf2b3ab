"""The knowledge of the parameters between updates, and its change with time, grain and moisture.

Updates are sweeps, weighed masses and kernel noise. The knowledge consists of the parameters' covariance, the rates of their
steady drift, the covariance that rates of unknown size may have added, and the bias of kernel noise, all as of the last update.
"""

from __future__ import annotations

from dataclasses import replace
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.calibrator_state import CalibratorState
from yieldmon.engine.self_calibration.drift_deviation import DriftDeviation, RateSpread, after_update, as_stated, force_deviation
from yieldmon.engine.self_calibration.held_since import HeldSince, Instant
from yieldmon.engine.self_calibration.prior_states import as_tuples
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration import drift_spread
from yieldmon.estimation.self_calibration.angle_pattern import with_pattern
from yieldmon.estimation.self_calibration.closed_loop_outcome import Outcome
from yieldmon.estimation.self_calibration.drift_rates import KG_PER_KT
from yieldmon.estimation.self_calibration.steady_drift import (
    Advance,
    DriftingParameters,
    advance,
    begin,
    carried,
    forgotten,
    updated,
    widened,
)
from yieldmon.estimation.waveform import common_bias
from yieldmon.estimation.waveform.common_bias import CommonBias, KernelUpdate
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

KERNEL_NOISE = "kernel_noise"
"""Key of the provenance of parameters that kernel noise has updated."""
FOLLOWED_KG = 20_000.0
"""Mass of grain after which an estimated steady drift moves the parameters without an update, and the standard deviations are
widened for drift."""
_LEAST_FOLLOWED = 1e-5
"""Least relative change of a parameter by steady drift for which the parameters are moved."""


class Carried(NamedTuple):
    """Parameters and rates as known now, and the step to them from the last update."""

    drifting: DriftingParameters
    step: Advance


class ParameterKnowledge:
    """The knowledge left by the last update, carried to now.

    Parameters
    ----------
    settings : CalibratorSettings
        Drift, its rates and their memory, the moisture map and the pattern of angles.

    Notes
    -----
    `used` is the set of parameters in use, compared by identity: knowledge of another set does not apply to it.
    """

    def __init__(self, settings: CalibratorSettings) -> None:
        self._settings = settings
        self._since = HeldSince()
        self._drifting: DriftingParameters | None = None
        self._bias: tuple[CommonBias, ParameterSet] | None = None
        """Bias of kernel noise, and the parameters that its covariance refers to; None where kernel noise has not updated
        these."""
        self._spread: RateSpread | None = None
        self._deviation: DriftDeviation | None = None

    @property
    def since_s(self) -> float:
        """Bus time of the last update, s; nan where not known yet."""
        return self._since.at.time_s

    @property
    def moisture_pct(self) -> float:
        """Of the grain for which the parameters hold; nan where it is not known."""
        return self._since.at.moisture_pct

    @property
    def drifting(self) -> DriftingParameters:
        """Parameters and rates after the last update. Raises LookupError before the first."""
        if self._drifting is None:
            raise LookupError("no update has been taken")
        return self._drifting

    def patterned(self, parameters: ParameterSet) -> ParameterSet:
        """A set with the pattern of angles, where the settings have one."""
        return with_pattern(parameters, self._settings.pattern_sd) if self._settings.pattern_sd > 0.0 else parameters

    def now(self, used: ParameterSet, at: Instant) -> Carried:
        """The parameters in use, moved by moisture and steady rates, and widened by random drift."""
        start = known = self._start(used)
        self._since.begin_counting(used, at.time_s, at.total_kg)
        moisture_map = self._settings.moisture_map
        if moisture_map is not None and isfinite(at.moisture_pct):
            if isfinite(self._since.at.moisture_pct):
                known = carried(known, moisture_map.moved(known.parameters, self._since.at.moisture_pct, at.moisture_pct))
            else:
                self._since.set_moisture(at.moisture_pct)
        self._since.begin(at)
        hours = max(at.time_s - self._since.at.time_s, 0.0) / 3600.0
        later, step = advance(
            known, self._settings.drift, hours, self._since.harvested_kg(at.total_kg),
            per_kilotonne=self._settings.steady_per_kilotonne, memory_kt=self._settings.steady_drift_memory_kt,
        )  # fmt: skip
        before, by_moisture = start.state, known.state
        carry = np.divide(by_moisture, before, out=np.ones_like(by_moisture), where=before != 0.0)
        step = replace(step, before=before, covariance_before=start.joint, transition=step.transition * carry)
        return Carried(later, step)

    def stated(self, used: ParameterSet, later: Carried, total_kg: float) -> ParameterSet:
        """The parameters with the covariance to state standard deviations by, which allows for rates of unknown size. later: as
        `now` returned it."""
        return as_stated(later.drifting.parameters, self._spread_at(used, later, total_kg))

    def bias(self, used: ParameterSet, step: Advance, total_kg: float) -> CommonBias | None:
        """The bias of kernel noise as it is now; None where its covariance with these parameters is not known."""
        if self._bias is None or self._bias[1] is not used or len(self._bias[0].cross) != len(step.transition):
            return None
        return common_bias.carried(self._bias[0], step.transition, total_kg - self._since.at.total_kg)

    def has_drifted(self, used: ParameterSet, total_kg: float) -> bool:
        """Whether steady drift has moved the parameters noticeably, over enough grain."""
        known, harvested_kg = self._drifting, total_kg - self._since.at.total_kg
        if known is None or known.parameters is not used or not harvested_kg >= FOLLOWED_KG:
            return False
        return bool(np.any(np.abs(known.rates) * (harvested_kg / KG_PER_KT) > _LEAST_FOLLOWED))

    def take(self, outcome: Outcome, used: ParameterSet, at: Instant, came: Carried, prior: Carried) -> ParameterSet:
        """Take an update by sweeps, weighed masses or drift alone.

        Parameters
        ----------
        outcome : Outcome
        used : ParameterSet
            Until now.
        at : Instant
        came : Carried
            The prior, as `now` returned it, widened where the update contradicted it.
        prior : Carried
            The same in the names of the outcome's parameters.

        Returns
        -------
        ParameterSet
            Those in use from now on.
        """
        drifting, before = prior.drifting, prior.drifting.parameters
        bias = self.bias(used, came.step, at.total_kg) if drifting is came.drifting else None
        whole = came.drifting.joint.shape == came.step.covariance_after.shape
        spread = self._spread_at(used, came, at.total_kg) if whole else None
        self._since.supersede(used, at)
        if not outcome.updated:
            # The moisture map or the drift alone has moved the values; the new prior is what is known.
            now = carried(drifting, replace(before, version=used.version + 1))
        elif outcome.parameter_set.covariance_names != before.covariance_names:
            now = begin(outcome.parameter_set, self._settings.steady_per_kilotonne)
        else:
            now = updated(drifting, outcome.parameter_set, widening=outcome.prior_widening)
        same = now.joint.shape == drifting.joint.shape and now.parameters.covariance_names == before.covariance_names
        before_update = bias
        if bias is not None and same and outcome.updated:
            bias = common_bias.followed(bias, drifting, now, widening=outcome.prior_widening)
        if not same:
            bias = None
        if spread is not None and outcome.updated:
            wide = widened(drifting.joint, before.covariance_names, outcome.prior_widening)
            spread = after_update(spread, wide, now, (before_update, bias))
        if bias is None and outcome.scale.observable and KERNEL_NOISE in now.parameters.provenance:
            # The scale is determined without kernel noise, whose bias is no longer known.
            facts = {key: text for key, text in now.parameters.provenance.items() if key != KERNEL_NOISE}
            now = replace(now, parameters=replace(now.parameters, provenance=facts))
        self._hold(now, bias, spread)
        return now.parameters

    def take_kernel_update(
        self, update: KernelUpdate, used: ParameterSet, known: ParameterSet, at: Instant, came: Carried
    ) -> None:
        """Take an update by kernel noise, from the parameters used until now to `known`; came: as `now` returned it."""
        spread = drift_spread.updated(self._spread_at(used, came, at.total_kg), update.errors)
        self._since.supersede(used, at)
        self._hold(replace(update.drifting, parameters=known), update.bias, spread)

    def use(self, before: ParameterSet | None, used: ParameterSet, harvested_kg: float) -> None:
        """Use other parameters than those of the last update: earlier ones, with the time of their estimation, or new ones.

        Parameters
        ----------
        before : ParameterSet or None
            In use until now.
        used : ParameterSet
        harvested_kg : float
            Grain since they were estimated, where they come from outside, kg.
        """
        self._since.use(before, used, harvested_kg)

    def begin_counting(self, used: ParameterSet, now_s: float, total_kg: float) -> None:
        """With the first window: start counting time and grain for parameters from outside."""
        self._since.begin_counting(used, now_s, total_kg)

    def _hold(self, drifting: DriftingParameters, bias: CommonBias | None, spread: Array | None) -> None:
        self._drifting = drifting
        self._bias = None if bias is None else (bias, drifting.parameters)
        self._spread = None if spread is None else RateSpread(spread, drifting.parameters)

    def is_new(self, used: ParameterSet) -> bool:
        """Whether these parameters came into use since the last call of `deviation`, and it is not known since when they hold."""
        seen = self._deviation
        return seen is not None and seen.parameters is not used and not self._since.is_of(used)

    def hold_from(self, record: WindowRecord) -> None:
        """Take the parameters in use as estimated at this window."""
        self._since.move(record.time_s, record.total_kg)

    def deviation(self, model: ForwardModel, used: ParameterSet, record: WindowRecord) -> float:
        """Relative standard deviation of the force by drift since the last update, beyond the parameters' covariance.

        Computed anew after each `FOLLOWED_KG` of grain.
        """
        self._since.begin_total(record.total_kg)
        seen = self._deviation
        if seen is None or seen.parameters is not used:
            seen = DriftDeviation(0.0, used, -1)
        steps = int(self._since.harvested_kg(record.total_kg) // FOLLOWED_KG)
        if seen.steps != steps and record.mass_flow_kg_s > 0.0:
            if steps:
                now = self.now(used, Instant(record.time_s, record.total_kg, nan))
                later = self.stated(used, now, record.total_kg)
            else:
                later = self._at_last_update(used)
            seen = DriftDeviation(force_deviation(model, used, later, record), used, steps)
        self._deviation = seen
        return seen.relative

    def totals_reset(self, before_kg: float) -> None:
        """The total begins anew at 0; it was before_kg."""
        self._since.totals_reset(before_kg)

    def snapshot(self, now_s: float, total_kg: float) -> CalibratorState | None:
        """The state to keep for a restart, without weighed loads and crops; None: nothing. now_s: bus time, s, nan before the
        first frame."""
        at, known = self._since.at, self._drifting
        if not isfinite(at.total_kg):
            return None
        count = 0 if known is None else len(known.parameters.covariance_names)
        return CalibratorState(
            waited_s=self._since.waited_s(now_s),
            harvested_kg=self._since.harvested_kg(total_kg),
            moisture_pct=at.moisture_pct if isfinite(at.moisture_pct) else None,
            drifting=() if known is None else known.names,
            rates=() if known is None else tuple(map(float, known.rates)),
            covariance=() if known is None else as_tuples(known.joint[count:]),
            at_s=self._since.at_s,
            bias=self._kept_bias(),
            spread=self._kept_spread(),
            past=self._since.past,
        )

    def restore(self, state: CalibratorState, parameters: ParameterSet, total_kg: float) -> None:
        """Go on from a snapshot, with the parameters that were in use then."""
        at = Instant(nan, total_kg - state.harvested_kg, nan if state.moisture_pct is None else state.moisture_pct)
        self._since.restore(parameters, at, at_s=state.at_s, waited_s=state.waited_s, past=state.past)
        fresh = begin(parameters, self._settings.steady_per_kilotonne)
        if len(state.bias) == 3 + len(fresh.joint) and fresh.parameters is parameters:
            value, variance, largest, *cross = state.bias
            self._bias = CommonBias(value, variance, np.array(cross), largest), parameters
        if len(state.spread) == 1 + len(fresh.joint) and fresh.parameters is parameters:
            self._spread = RateSpread(np.array(state.spread), parameters)
        if not state.drifting or fresh.names != state.drifting or len(state.covariance[0]) != len(fresh.joint):
            return  # No rates stored, or of other parameters: they begin anew.
        rows, joint = np.array(state.covariance), fresh.joint.copy()
        joint[-len(rows) :, :] = rows
        joint[:, -len(rows) :] = rows.T
        self._drifting = replace(fresh, rates=np.array(state.rates), joint=joint)

    def _start(self, used: ParameterSet) -> DriftingParameters:
        """State at the last update: its result for the parameters in use, else these with unknown rates."""
        known = self._drifting
        if known is None or known.parameters is not used:
            return begin(self.patterned(used), self._settings.steady_per_kilotonne)
        return known

    def _spread_at(self, used: ParameterSet, later: Carried, total_kg: float) -> Array:
        """Covariance that rates of unknown size may have added until now; later: as `now` returned it."""
        gone = forgotten(
            self._start(used), self._since.harvested_kg(total_kg),
            per_kilotonne=self._settings.steady_per_kilotonne, memory_kt=self._settings.steady_drift_memory_kt,
        )  # fmt: skip
        return RateSpread.at(self._spread, used, later.step, later.drifting, gone)

    def _at_last_update(self, used: ParameterSet) -> ParameterSet:
        """The parameters in use with the covariance to state standard deviations by, as of the last update."""
        spread = self._spread
        return used if spread is None or spread.parameters is not used else as_stated(used, spread.covariance)

    def _kept_bias(self) -> tuple[float, ...]:
        if self._bias is None or self._drifting is None or self._bias[1] is not self._drifting.parameters:
            return ()
        bias = self._bias[0]
        return (bias.value, bias.variance, bias.largest, *map(float, bias.cross))

    def _kept_spread(self) -> tuple[tuple[float, ...], ...]:
        if self._spread is None or self._drifting is None or self._spread.parameters is not self._drifting.parameters:
            return ()
        return as_tuples(self._spread.covariance)
