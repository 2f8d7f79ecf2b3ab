"""One effect alone as the cause of what many machines' mean shows.

The mean of a fleet is known to a few tenths of a percent, to which no model is true. The forward search tests gains with what
laws may be off, so it takes what the model's own error makes of such a mean for further effects, or is left with a misfit. Here
each effect is asked alone, in every law, by evidence with both errors integrated out and with what is known of the crop's grain
beforehand (`Frame.prior`): an effect that needs a friction or density which the crop does not have explains less.
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
    """An effect alone, in the law with most evidence. merit: -2 log of that."""

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
    """What a search found, or the one effect that explains the cells by itself.

    Parameters
    ----------
    found : Choice
        Of the forward search. Stands where it is one effect or none; where the one effect is none of those that it found, unless
        the evidence for it before every other one is very strong; and where each of several effects is a name and the evidence
        for them beside one is very strong.
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
        # Beside rivals that are far behind, what the model's own error makes in the mean is no part of the misfit.
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
    """Each effect that can be fitted, in the law that has most evidence."""
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
    """What is left beyond the noise with the model's own error and what laws may be off integrated out, which leaves a chi-square
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
