"""The update by weighed masses: near the prior, or by fitting the last loads together.

A ticket that the prior explains, drift included, updates the parameters as any observation does. A ticket further off, or one of
a machine that was never calibrated, is fitted together with the loads before it (`estimation.weighing.loads`).
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.load_pattern import EFFECT as LOAD_PATTERN
from yieldmon.estimation.other_monitor import with_bias, with_new_bias
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop import update_from_tickets
from yieldmon.estimation.self_calibration.closed_loop_inputs import WeighedMass
from yieldmon.estimation.self_calibration.closed_loop_outcome import Outcome, ScaleReport
from yieldmon.estimation.self_calibration.steady_drift import DriftingParameters
from yieldmon.estimation.weighing.density_and_gain import in_form_of, widened
from yieldmon.estimation.weighing.load_departures import departures, errors_of, spread
from yieldmon.estimation.weighing.load_inputs import LoadSettings, WeighedLoad
from yieldmon.estimation.weighing.load_outcome import LIKELY_ANOTHER, LoadCalibration, curve_sentence, wrong_ticket_sentence
from yieldmon.estimation.weighing.loads import calibrate_loads
from yieldmon.physics.effects.other_monitor import BIAS
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

_DRIFT_WIDENING = 16.0
"""Largest widening of the parameters' covariance for which the deviation of a later ticket is drift, not another scale."""
_DOUBLED = 4.0
_DRIFT_SD = 0.02
"""Relative standard deviation of a load beyond which a widening above `_DOUBLED` could be a wrong ticket as well as drift."""
_KNOWN_SCALE = 0.1
"""Relative standard deviation of a load below which the parameters determine the machine's scale."""


@dataclass(frozen=True, slots=True)
class LoadUpdate:
    """An update from weighed masses.

    Attributes
    ----------
    model : ForwardModel
        With the effects of the parameters in use.
    closed_loop : ClosedLoopSettings
    load_settings : LoadSettings
    counted : sequence of WeighedLoad
        The last loads that count, the new ones included.
    origin : ParameterSet or None
        Parameters as they came from outside.
    """

    model: ForwardModel
    closed_loop: ClosedLoopSettings
    load_settings: LoadSettings
    counted: Sequence[WeighedLoad]
    origin: ParameterSet | None

    def of(
        self, drifting: DriftingParameters, masses: Sequence[WeighedMass], names: Container[str]
    ) -> tuple[Outcome, DriftingParameters]:
        """The parameters after weighed masses of these names, and the prior, widened where they contradict it.

        Raises ValueError where no parameters explain them.
        """
        prior, counted = drifting.parameters, self.counted
        if any(mass.common_kg > 0.0 for mass in masses):
            prior = with_bias(prior)
        outcome = update_from_tickets(self.model, prior, masses, settings=self.closed_loop)
        doubtful = 1.0 if len(counted) <= len(masses) else _DRIFT_WIDENING
        near = outcome.consistent and outcome.prior_widening <= doubtful and self._is_drift(outcome.prior_widening, prior, names)
        near = near and not prior.carried_from and self._without_curve(prior) is prior
        beside_prior, follows = self._near(outcome, prior, names) if near else (None, False)
        if beside_prior is not None and follows:
            return beside_prior, drifting
        # Outside the prior's standard deviations, or so far that its linearisation about the earlier loads no longer holds:
        # only the loads together determine the scale.
        try:
            in_prior = [load.name for load in counted if load.name not in names]
            found = calibrate_loads(
                self.model, self._without_curve(prior), counted, settings=self.load_settings, in_prior=in_prior
            )
        except ValueError:
            if beside_prior is not None:
                return beside_prior, drifting
            raise
        if beside_prior is not None and (found.refused or found.contradiction is not None) and not _is_another(found):
            return beside_prior, drifting
        outcome = Outcome.unchanged(_in_order_of(prior, found.parameter_set))
        scale = ScaleReport(
            found.scale_sd, found.scale_sd, float(np.log(found.scale)), observable=True, unobservable_directions=()
        )
        outcome = replace(outcome, updated=not found.refused, reason=self._reason(found, prior, names), scale=scale)
        outcome = replace(outcome, dof=len(counted))
        return outcome, self._widened(drifting, outcome.parameter_set.covariance_names)

    def _widened(self, drifting: DriftingParameters, names: tuple[str, ...]) -> DriftingParameters:
        """The prior with density and gain as uncertain as on a machine that was never calibrated, if its covariance has these
        names; else unchanged."""
        prior = drifting.parameters
        wide = widened(prior, self.load_settings)
        if BIAS in names and any(load.common_kg > 0.0 for load in self.counted):
            wide = with_new_bias(wide)
        if names != prior.covariance_names or set(names) != set(wide.covariance_names):
            return drifting
        joint = drifting.joint.copy()
        joint[: len(names), : len(names)] = wide.covariance_of(names)
        return replace(drifting, parameters=replace(prior, covariance=wide.covariance_of(names)), joint=joint)

    def _near(self, outcome: Outcome, prior: ParameterSet, names: Container[str]) -> tuple[Outcome | None, bool]:
        """The outcome of an update near the prior, saying by how much it changed the mass of these loads; and whether
        it changes the earlier loads by less than the uncertainty of the prior, drift included.

        None where the prior does not determine the machine's scale: on one that was never calibrated only the loads together
        determine the scale and how far the force follows the model's curve.
        """
        if not self.counted:
            return outcome, True
        new = self._are(names)
        before, std_dev = self._departures(prior)
        if not np.all(std_dev[new] < _KNOWN_SCALE):
            return None, False
        after = self._errors(outcome.parameter_set)
        follows = np.abs(after - before)[~new] < self.load_settings.outlier_sds * std_dev[~new]
        moved = _moved(before[new], after[new])
        if outcome.updated and np.isfinite(moved):
            said = f"weighed loads moved the scale by {100.0 * moved:+.1f} %; {outcome.reason}"
            outcome = replace(outcome, reason=said)
        return outcome, bool(np.all(follows))

    def _departures(self, known: ParameterSet) -> Array:
        """Relative error of each counted load's mass by these parameters, drift included, and its standard deviation, (2, n)."""
        return self._of_each(lambda loads: np.stack(departures(self.model, known, loads, self.load_settings)))

    def _errors(self, known: ParameterSet) -> Array:
        """The errors of `_departures`, (n,)."""
        return self._of_each(lambda loads: errors_of(self.model, known, loads, self.load_settings))

    def _of_each(self, figure: Callable[[Sequence[WeighedLoad]], Array]) -> Array:
        """Figures (..., n) of the counted loads, in their order; those with moisture and those without are worked out apart."""
        with_moisture = np.array([load.moisture_pct is not None for load in self.counted], dtype=bool)
        parts = [np.flatnonzero(which) for which in (with_moisture, ~with_moisture) if which.any()]
        found = np.concatenate([figure([self.counted[int(place)] for place in part]) for part in parts], axis=-1)
        return np.asarray(found[..., np.argsort(np.concatenate(parts))])

    def _reason(self, found: LoadCalibration, prior: ParameterSet, names: Container[str]) -> str:
        """The sentence for the operator on a calibration by all weighed loads; those of these names are new. prior: until now."""
        if found.refused:
            return " ".join(found.sentences)
        new = self._are(names)
        moved = _moved(*(self._errors(known)[new] for known in (prior, found.parameter_set)))
        scale = moved if np.isfinite(moved) else found.scale - 1.0
        said = (
            f"weighed loads moved the scale by {100.0 * scale:+.1f} %; a next load is expected within "
            f"{100.0 * found.next_load_sd:.1f} %"
        )
        alone = "by one ticket alone: if it is wrong by 10 %, so is every load, until a second shows it"
        curve = curve_sentence(found) if _is_another(found) else ""
        return "; ".join(filter(None, (said, alone if len(self.counted) == 1 else "", curve, wrong_ticket_sentence(found))))

    def _is_drift(self, widening: float, prior: ParameterSet, names: Container[str]) -> bool:
        """Whether a covariance that is multiplied by `widening` is no wider than drift makes it."""
        if widening <= _DOUBLED:
            return True
        spreads = (spread(self.model, prior, load, self.load_settings) for load in self._of(names))
        return all(widening**0.5 * known <= _DRIFT_SD for known in spreads)

    def _are(self, names: Container[str]) -> NDArray[np.bool_]:
        """Which of the counted loads have one of these names, (n,)."""
        return np.array([load.name in names for load in self.counted], dtype=bool)

    def _of(self, names: Container[str]) -> list[WeighedLoad]:
        return [load for load in self.counted if load.name in names]

    def _without_curve(self, prior: ParameterSet) -> ParameterSet:
        """The parameters before weighed loads of this crop gave a curve of their own, as the prior for fitting all of them
        together."""
        origin = self.origin
        if LOAD_PATTERN not in prior.effects or prior.carried_from or origin is None:
            return prior
        if LOAD_PATTERN in origin.effects and not origin.carried_from:
            return prior
        return in_form_of(replace(origin, version=prior.version), prior)


def _moved(before: Array, after: Array) -> float:
    """Relative change of loads' masses from their relative errors (n,) before and after; nan for no load."""
    return float(np.expm1(np.mean(np.log1p(after) - np.log1p(before)))) if before.size else np.nan


def _in_order_of(prior: ParameterSet, known: ParameterSet) -> ParameterSet:
    """`known`, its covariance in the order of the prior's names, then its own."""
    names = tuple(name for name in prior.covariance_names if name in known.covariance_names)
    names += tuple(name for name in known.covariance_names if name not in names)
    return replace(known, covariance_names=names, covariance=known.covariance_of(names))


def _is_another(found: LoadCalibration) -> bool:
    """Whether the loads show another curve of the force than the model's."""
    return found.another_law is not None and found.another_law.probability > LIKELY_ANOTHER
