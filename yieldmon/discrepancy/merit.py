"""Comparison of two fits: evidence, complexity of an effect, margin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from yieldmon.estimation.model_error import off, orthonormal

from .alternatives import FREE_SHAPE, chosen_from_all, of_other_laws
from .choice import Step
from .fit import Fit, fit
from .lack_of_fit import lack_of_fit
from .noise import Noise
from .policy import Policy


def far_ahead(found: Fit, steps: Sequence[Step], policy: Policy) -> bool:
    """Whether one effect explains the rows, with very strong evidence against every rival that is not tied."""
    return len(found.effects) == 1 and steps[0].margin >= chosen_from_all(policy.per_parameter)


def by_own_error(found: Fit) -> float:
    """Mean chi-square by the model error."""
    return float(np.sum(off(found.own_error, found.tangent()) ** 2))


def left_by_own_law(found: Fit, steps: Sequence[Step], noise: Noise, excess: float, policy: Policy) -> bool:
    """Whether one effect, far better than all others, leaves a small misfit that another shape of its law explains.

    The chi-square by the model error is not part of the misfit.
    """
    if not far_ahead(found, steps, policy):
        return False
    small = found.chi2 - found.dof - by_own_error(found) <= policy.own_law_share * excess
    written = lack_of_fit(found, noise, laws=False)
    if not (small and written.p_value < policy.lack_of_fit_p):
        return False
    return lack_of_fit(found, noise, beside=of_other_laws(found, FREE_SHAPE)).p_value >= policy.lack_of_fit_p


def misfit(fits: Sequence[Fit]) -> float:
    """Chi-square per degree of freedom of the best fit with errors of laws integrated out, at least 1; the unit of
    differences."""
    return max(min((f.integrated[0] / max(f.dof, 1) for f in fits), default=1.0), 1.0)


def merit(candidate: Fit, scale: float, policy: Policy) -> float:
    """-2 log of a fit's evidence: chi-square / `scale` with errors integrated out, plus the cost of its parameters.

    The cost depends on the number of parameters and their distance from the prior in wide prior widths. A parameter of a law's
    shape costs less the less the rows determine it, since it is integrated over its prior.
    """
    chi2, volume = candidate.integrated
    cost = volume + sum(parameter_costs(candidate, policy.per_parameter))
    for p, v in zip(candidate.parameters, candidate.x, strict=True):
        if np.isfinite(p.prior_sd):
            cost += min(((float(v) - p.start) / (5.0 * p.prior_sd)) ** 2, 4.0)
    return chi2 / scale + cost


def parameter_costs(found: Fit, per_parameter: float) -> list[float]:
    """What each parameter costs in -2 log evidence."""
    shapes = found.shapes
    out = [per_parameter] * len(found.parameters)
    for place in shapes:
        others = np.delete(found.jacobian, shapes, axis=1) * np.delete([p.scale for p in found.parameters], shapes)
        settled = off(found.jacobian[:, place], orthonormal(others)) * found.parameters[place].prior_sd
        out[place] = min(per_parameter, float(np.log1p(settled @ settled)))
    return out


def by_weight(current: Fit, order: Sequence[str]) -> list[str]:
    """Effects in descending order of the increase of chi-square without each."""
    if len(order) < 2:
        return list(order)
    costs = {}
    for name in order:
        reduced = fit(current.frame, tuple(e for e in current.effects if e != name), current.values)
        costs[name] = reduced.chi2 if reduced is not None else np.inf
    return sorted(order, key=lambda name: -costs[name])
