"""Objections to naming the effects that a search found as the cause of the misfit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.physics.effects import family_of

from .alternatives import by_powers, chosen_from_all, needed, one_angle_off
from .choice import Step, rows_searched
from .fit import Fit, fit
from .lack_of_fit import lack_of_fit, lack_of_fit_but_one
from .merit import by_own_error, far_ahead, left_by_own_law, merit, misfit
from .noise import Noise
from .policy import DEFAULT, Policy
from .run_order import is_asked, of_order, speeds_in_turn


@dataclass(frozen=True, kw_only=True)
class Objections:
    """Tests fits with effects on the rows to which they were fitted.

    Parameters
    ----------
    base : Fit
        The published model.
    noise : Noise
        Noise of the rows.
    policy : Policy
        Thresholds.
    """

    base: Fit
    noise: Noise
    policy: Policy = DEFAULT

    @property
    def excess(self) -> float:
        """Excess of the published model's chi-square over its degrees of freedom."""
        return max(self.base.chi2 - self.base.dof, 1e-9)

    def incomplete(self, current: Fit) -> bool:
        """Whether the data show that an effect is still missing."""
        test = lack_of_fit(current, self.noise)
        return test.f > self.policy.complete_f and test.p_value < self.policy.lack_of_fit_p

    def unexplained(self, current: Fit) -> bool:
        """Whether the remaining misfit is significant and too large to be called explained, whatever the effects' laws are."""
        test = lack_of_fit(current, self.noise, laws=False)
        family = lack_of_fit(current, self.noise)
        most = max(self.policy.unexplained_f, self.policy.unexplained_of_f * lack_of_fit(self.base, self.noise).f)
        much = family.f > most or current.chi2 - current.dof > self.policy.unexplained_share * self.excess
        return test.p_value < self.policy.lack_of_fit_p and much

    def first(self, current: Fit, steps: Sequence[Step]) -> str:
        """The first objection to naming the steps of a fit as the cause; "" if there is none."""
        tied = 1 + len(steps[0].equivalent)
        if tied > self.policy.largest_class:
            return f"{tied} effects explain these rows alike"
        test = lack_of_fit(current, self.noise)
        # If rivals are hardly worse, an effect must also explain the misfit that the model error may cause.
        owned = by_own_error(current) if far_ahead(current, steps, self.policy) else 0.0
        left = (current.chi2 - current.dof - owned) / self.excess
        searched = rows_searched(current)
        other_law = left_by_own_law(current, steps, self.noise, self.excess, self.policy)
        refuted = test.p_value < self.policy.lack_of_fit_p and not other_law
        if refuted and lack_of_fit_but_one(current, self.noise)[0].p_value < self.policy.lack_of_fit_p:
            why = "something else is missing, or stands in its place"
            return f"F = {test.f:.2f} is left with it {searched} (p = {test.p_value:.1g}): {why}"
        if left > self.policy.unexplained_share:
            most = 100.0 * self.policy.unexplained_share
            return f"{100.0 * left:.1f} % of the excess is left with it {searched}, more than {most:.0f} %"
        if not other_law and self.unexplained(current):
            return f"F = {test.f:.2f} is left with it {searched}, more than what its law may be off explains"
        return self._other_laws(current) or self._of_powers(current) or self._of_one_angle(current) or self._of_order(current)

    def _other_laws(self, current: Fit) -> str:
        """Why other laws of the other effects may explain the rows instead of one of several effects; "" if none may."""
        scale = misfit([current])
        each = needed(current, scale, self.policy.per_parameter)
        if not each:
            return ""
        weakest = min(each, key=lambda one: one.evidence)
        if weakest.evidence < self.policy.least_evidence:
            name = family_of(weakest.effect)
            return f"another law of the other effects is as likely as {name} (-2 log evidence {weakest.evidence:.1f})"
        least = chosen_from_all(self.policy.per_parameter)
        gain = min(one.gain for one in each)
        if current.cancelled > self.policy.most_cancelled and gain < least:
            return (
                f"{100.0 * current.cancelled:.0f} % of what these effects change cancels out, as in the terms of a series, "
                f"and other laws would serve (chi-square {max(gain, 0.0):.0f} worse, where {least:.0f} are needed)"
            )
        return ""

    def _of_powers(self, current: Fit) -> str:
        """Why a law without a cause explains the rows better; "" if it does not."""
        scale = misfit([current])
        without_cause = by_powers(self.base, scale, self.policy.per_parameter)
        if without_cause is None or without_cause >= merit(current, scale, self.policy):
            return ""
        return "powers of load, elevator speed and sin(plate angle) alone, without a cause, explain the rows better"

    def _of_one_angle(self, current: Fit) -> str:
        """Why the rows of a single plate angle may be wrong; "" if there is no sign of it."""
        scale = misfit([current])
        alone = one_angle_off(self.base, scale, self.policy.per_parameter)
        if alone is None:
            return "rows of one plate angle cannot separate an effect from an error that all of them share"
        if alone.merit > merit(current, scale, self.policy) + self.policy.tie:
            return ""
        at = f"{np.degrees(alone.plate_angle_rad):.0f} deg"
        return f"an error of the rows at {at} alone explains the misfit as well"

    def _of_order(self, current: Fit) -> str:
        """Why a drift in the order of measurement may be the cause instead of an effect; "" if not."""
        if not is_asked(current.frame.cells.rows):
            return ""
        scale = misfit([current])
        most = merit(current, scale, self.policy) + self.policy.tie
        for effect in current.effects:
            without = fit(current.frame, tuple(e for e in current.effects if e != effect), current.values)
            other = of_order(without, scale, self.policy.per_parameter) if without is not None else None
            if other is not None and other.merit <= most:
                rows = current.frame.cells.rows
                how = "the table has its rows speed by speed" + ("" if not speeds_in_turn(rows) else " in each trial")
                how = "`time_s` shows" if rows.timed else how
                return f"{other.what} explains the rows as well as {family_of(effect)} ({how})"
        return ""
