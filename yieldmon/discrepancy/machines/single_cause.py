"""A single effect as the cause of the error common to many machines.

The mean of a fleet has an uncertainty of a few tenths of a percent, which is less than the error of any model. The forward search
only includes errors of laws in its tests, so it attributes the model error in such a mean to further effects, or leaves a misfit.
Here each effect is tested alone, with every law, by its evidence with both errors integrated out and with the prior of the crop's
grain (`Frame.prior`). An effect that needs a friction or density that the crop does not have is then a poor explanation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from yieldmon.discrepancy.alternatives import chosen_from_all
from yieldmon.discrepancy.base_fit import fit_base
from yieldmon.discrepancy.candidates import false_alarm, lawful, only_at_bound, polished, refit, score, signature
from yieldmon.discrepancy.choice import Choice, Step
from yieldmon.discrepancy.fit import Fit, fit
from yieldmon.discrepancy.frame import Frame
from yieldmon.discrepancy.lack_of_fit import LackOfFit, lack_of_fit
from yieldmon.discrepancy.merit import merit
from yieldmon.discrepancy.noise import Noise
from yieldmon.discrepancy.policy import Policy
from yieldmon.physics.effects import family_of


@dataclass(frozen=True)
class _Alone:
    """A single effect with the law of the largest evidence. merit: -2 log of the evidence."""

    law: str
    fit: Fit
    merit: float

    @property
    def effect(self) -> str:
        """The law's."""
        return family_of(self.law)


def of_one_cause(
    found: Choice, frame: Frame, noise: Noise, effects: tuple[str, ...], rng: np.random.Generator, policy: Policy
) -> Choice:
    """The result of a search, or the single effect that explains the cells.

    Parameters
    ----------
    found : Choice
        Result of the forward search. It is kept in three cases: it has one effect or none; the single effect is not among those
        found, unless its evidence relative to every other one is very strong; or each of the found effects is a name and the
        evidence for them against a single one is very strong.
    frame : Frame
        The cells, with the prior of the crop's grain.
    noise : Noise
        Of the cells.
    effects : tuple of str
        Names to choose from.
    rng : numpy.random.Generator
        Of the false-alarm rate.
    policy : Policy
        Thresholds; an effect tied with more than `largest_class` is no name.

    Returns
    -------
    Choice
    """
    if found.verdict == "none" or (found.verdict == "effect" and len(found.steps) == 1):
        return found
    base = fit_base(frame)
    ranked = sorted(_alone(base, effects, policy), key=lambda one: one.merit)
    if not ranked:
        return found
    best, *others = ranked
    tied = tuple(one.effect for one in others if one.merit <= best.merit + policy.tie)
    signatures = [signature(base, law) for law in lawful(effects)]
    p_any = false_alarm(signatures, base, noise, rng)(base.chi2 - best.fit.chi2)
    beyond = min((one.merit - best.merit for one in others if one.effect not in tied), default=float("inf"))
    far_ahead = beyond >= chosen_from_all(policy.per_parameter)
    agrees = far_ahead or any(best.effect in (step.added, *step.equivalent) for step in found.steps)
    test = _beyond_errors(best.fit, noise)
    if far_ahead and test.p_value < policy.lack_of_fit_p:
        # If all rivals are far worse, the mean chi-square by the model error is not counted in the misfit.
        test = lack_of_fit(best.fit, noise, beside=best.fit.error)
    clear = p_any < policy.first_p and test.p_value >= policy.lack_of_fit_p and 1 + len(tied) <= policy.largest_class
    if (
        not (agrees and clear)
        or only_at_bound(best.fit, best.law, policy.bound_allowance)
        or _better(found, frame, best.merit, policy)
    ):
        return found
    step = Step(best.effect, (), tied, 1.0 - p_any, best.law, margin=beyond)
    return replace(
        found, verdict="effect", base=base, best=best.fit, lack_of_fit_after=test, steps=(step,), p_any=p_any, objection=""
    )


def _alone(base: Fit, effects: tuple[str, ...], policy: Policy) -> Iterator[_Alone]:
    """Each effect that can be fitted, with the law of the largest evidence."""
    for effect in effects:
        laws = []
        for law in lawful((effect,)):
            begun = refit(base, score(base, signature(base, law)), starts=policy.starts)
            if begun is not None:
                ended = polished(begun)
                laws.append(_Alone(law, ended, _merit(ended, policy)))
        if laws:
            yield min(laws, key=lambda one: one.merit)


def _beyond_errors(found: Fit, noise: Noise) -> LackOfFit:
    """Misfit beyond the noise with the model error and errors of the laws integrated out, which has a chi-square distribution
    with the fit's degrees of freedom."""
    f = found.integrated[0] / found.dof
    return LackOfFit(f, float(scipy.stats.f.sf(f, found.dof, noise.dof)))


def _merit(found: Fit, policy: Policy) -> float:
    return merit(found, 1.0, policy) + found.beside_prior


def _better(found: Choice, frame: Frame, merit: float, policy: Policy) -> bool:
    """Whether each of the several effects that a search chose from the library is a name, and the evidence very strong."""
    if found.verdict != "effect" or any(1 + len(step.equivalent) > policy.largest_class for step in found.steps):
        return False
    several = fit(frame, found.best.effects, found.best.values)
    return several is not None and _merit(several, policy) + chosen_from_all(0.0) < merit
