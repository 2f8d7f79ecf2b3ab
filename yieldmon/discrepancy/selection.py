"""Which effects to name: forward steps with exchange, a global false-alarm rate, ties, and the right to say "unknown".

An effect is judged as a family of laws: what its own law may be off is integrated out (`Fit.shape_error`), beside the model's own
error, so neither a tie nor a gap rests on one way to write it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.documents.diagnose import Verdict
from yieldmon.physics.effects import family_of
from yieldmon.physics.numerics import Array

from .alternatives import chosen_from_all, needed, one_angle_off
from .candidates import (
    Score,
    errors,
    false_alarm,
    lawful,
    leading,
    only_at_bound,
    polished,
    refit,
    refit_from_restarts,
    score,
    signature,
)
from .choice import Candidate, Choice, Step, rows_searched
from .crossvalidation import grouped_error
from .fit import Fit, fit
from .gap import lack_of_fit, lack_of_fit_but_one
from .merit import by_own_error, by_weight, far_ahead, left_by_own_law, merit, misfit
from .noise import Noise
from .pairs import screen
from .policy import DEFAULT, Policy
from .run_order import is_asked, of_order, speeds_in_turn

Progress = Callable[[str, float], None]
Places = dict[str, tuple[Candidate, ...]]
"""The candidates last seen in the place of each effect, beside the present others."""


def choose(
    base: Fit,
    noise: Noise,
    effects: tuple[str, ...],
    rng: np.random.Generator,
    policy: Policy = DEFAULT,
    progress: Progress | None = None,
) -> Choice:
    """Forward selection from the fitted published model, exchange of each effect after each step, then the verdict."""
    return Search(base=base, noise=noise, effects=effects, rng=rng, policy=policy).run(progress or (lambda text, share: None))


@dataclass(frozen=True, kw_only=True)
class Search:
    """One search through a library of effects.

    Parameters
    ----------
    base
        The published model, fitted.
    noise
        Of the rows.
    effects
        Names to choose from.
    rng
        Of the Monte Carlo draws.
    policy
        Thresholds.
    """

    base: Fit
    noise: Noise
    effects: tuple[str, ...]
    rng: np.random.Generator
    policy: Policy = DEFAULT

    @property
    def excess(self) -> float:
        """Chi-square of the published model above its degrees of freedom."""
        return max(self.base.chi2 - self.base.dof, 1e-9)

    def run(self, report: Progress) -> Choice:
        """The whole search."""
        base_gap = lack_of_fit(self.base, self.noise)
        current, order, places = self.base, list[str](), Places()
        looked_at: tuple[Candidate, ...] = ()
        p_any = 1.0
        for number in range(self.policy.most_effects):
            report(f"step {number + 1}: {len(self.effects) - number} candidates", number / self.policy.most_effects)
            found = self.candidates(current, self._others(current), self.policy.refits)
            if number == 0:
                looked_at = found
                p_any = min((c.p_value for c in found), default=1.0)
            good = self.admissible(found, current)
            leader = order
            if number == 1 and lack_of_fit(current, self.noise).p_value < self.policy.gap_p:
                report("step 2: all pairs", 0.45)
                better = self._better_pair(looked_at, order[0], good)
                if better is not None:
                    leader, good, found = better
            if not good:
                break
            current, order, places = good[0].fit, [*leader, good[0].effect], {good[0].effect: found}
            if number > 0:
                report(f"step {number + 1}: exchange", (number + 0.6) / self.policy.most_effects)
                current, order, places = self._exchange(current, order, places)
            if lack_of_fit(current, self.noise).p_value < self.policy.gap_p:
                current = refit_from_restarts(current)
        if not order:
            verdict: Verdict = "unknown" if base_gap.p_value < self.policy.gap_p else "none"
            return Choice(verdict, self.base, self.base, base_gap, base_gap, (), looked_at, p_any)
        current, steps, rivals = self.prune_ambiguous(current, order, places, p_any)
        against = self.against(current, steps)
        if against and (fewer := self.without_unneeded(current, p_any)) is not None:
            (current, steps, rivals), against = fewer, ""
        verdict = "unknown" if against else "effect"
        gap = lack_of_fit(current, self.noise)
        return Choice(verdict, self.base, current, base_gap, gap, steps, looked_at, p_any, rivals, against)

    def against(self, current: Fit, steps: Sequence[Step]) -> str:
        """What speaks against calling the steps of a fit the cause; "" where nothing does."""
        tied = 1 + len(steps[0].equivalent)
        if tied > self.policy.largest_class:
            return f"{tied} effects explain these rows alike"
        gap = lack_of_fit(current, self.noise)
        # Beside rivals that are hardly worse, an effect has to explain what the model's own error may have made as well.
        owned = by_own_error(current) if far_ahead(current, steps, self.policy) else 0.0
        left = (current.chi2 - current.dof - owned) / self.excess
        searched = rows_searched(current)
        other_law = left_by_own_law(current, steps, self.noise, self.excess, self.policy)
        refuted = gap.p_value < self.policy.gap_p and not other_law
        if refuted and lack_of_fit_but_one(current, self.noise)[0].p_value < self.policy.gap_p:
            why = "something else is missing, or stands in its place"
            return f"F = {gap.f:.2f} is left with it {searched} (p = {gap.p_value:.1g}): {why}"
        if left > self.policy.unexplained_share:
            most = 100.0 * self.policy.unexplained_share
            return f"{100.0 * left:.1f} % of the excess is left with it {searched}, more than {most:.0f} %"
        if not other_law and self._unexplained(current):
            return f"F = {gap.f:.2f} is left with it {searched}, more than what its law may be off explains"
        return self._other_laws(current) or self._of_one_angle(current) or self._of_order(current)

    def _other_laws(self, current: Fit) -> str:
        """Why other laws of the others may be at work instead of one of several effects; "" where none may."""
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
        if current.undone > self.policy.most_undone and gain < least:
            return (
                f"{100.0 * current.undone:.0f} % of what these effects change they undo among themselves, as terms of a series "
                f"do, and other laws would serve (chi-square {max(gain, 0.0):.0f} worse, where {least:.0f} are needed)"
            )
        return ""

    def _of_one_angle(self, current: Fit) -> str:
        """Why the rows of a single plate angle may be what is wrong; "" where they are not."""
        scale = misfit([current])
        alone = one_angle_off(self.base, scale, self.policy.per_parameter)
        if alone is None:
            return "rows of one plate angle cannot separate an effect from an error that all of them share"
        if alone.merit > merit(current, scale, self.policy) + self.policy.tie:
            return ""
        at = f"{np.degrees(alone.plate_angle_rad):.0f} deg"
        return f"an error of the rows at {at} alone explains the gap as well"

    def _of_order(self, current: Fit) -> str:
        """Why the order in which the rows were measured may be at work in the place of an effect; "" where it may not."""
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

    def candidates(
        self,
        current: Fit,
        effects: Sequence[str],
        refits: int,
        *,
        beside: Mapping[str, float] | None = None,
    ) -> tuple[Candidate, ...]:
        """The `refits` most promising effects, refitted (also from `beside`, see `candidates.refit`), best first.

        Each stands in its best law.
        """
        signatures = [signature(current, law) for law in lawful(effects)]
        p_value = false_alarm(signatures, current, self.noise, self.rng)
        worth = self._by_family([score(current, s) for s in signatures])[:refits]
        groups = current.frame.cells.groups()
        out = []
        for s, added in self._fitted(current, worth, beside):
            gain = current.chi2 - added.chi2
            # A bound that the data do not refute is no evidence against the effect.
            complete = lack_of_fit(added, self.noise).p_value >= self.policy.gap_p
            refused = "" if complete else only_at_bound(added, s.effect, self.policy.bound_allowance)
            missed = grouped_error(added, groups)
            unseen = float(np.mean(list(missed.values()) or [np.nan]))
            out.append(Candidate(s.effect, added, gain, p_value(gain), unseen, refused))
        scale = misfit([c.fit for c in out])
        return tuple(sorted(out, key=lambda c: merit(c.fit, scale, self.policy)))

    def _by_family(self, scores: Iterable[Score]) -> list[list[Score]]:
        """Scores of each effect's laws together, the most promising effect and law first; laws far behind are left out."""
        families: dict[str, list[Score]] = {}
        for s in sorted(scores, key=lambda s: -s.gain):
            families.setdefault(family_of(s.effect), []).append(s)
        return [[s for s in of if s.gain >= self.policy.law_share * of[0].gain] for of in families.values()]

    def _fitted(
        self, current: Fit, worth: Sequence[Sequence[Score]], beside: Mapping[str, float] | None
    ) -> list[tuple[Score, Fit]]:
        """Each effect's refit by its best law; a law that a few steps leave far behind the best is not taken to the end."""
        short = self.policy.short_search
        begun: list[list[tuple[Score, Fit]]] = []
        for of_family in worth:
            rough = [(s, refit(current, s, starts=self.policy.starts, beside=beside, iterations=short)) for s in of_family]
            begun.append([(s, f) for s, f in rough if f is not None])
        each = [f for laws in begun for _, f in laws]
        scale, least = misfit(each), min((f.chi2 for f in each), default=0.0)
        limit = least + self.policy.hopeless * scale + 0.25 * (current.chi2 - least)
        # A few steps do not rank the laws of one effect: what leads after them may be behind at the end.
        ended = [[(s, polished(f) if f.chi2 <= limit else f) for s, f in laws] for laws in begun if laws]
        return [min(laws, key=lambda found: found[1].chi2) for laws in ended]

    def admissible(self, found: Sequence[Candidate], current: Fit) -> list[Candidate]:
        """Those that may be added to `current`: significant, large enough, predictive, within bounds."""
        groups = current.frame.cells.groups()
        before = float(np.mean(list(grouped_error(current, groups).values()) or [np.nan]))
        first = not current.effects
        incomplete = self._incomplete(current)
        level = self.policy.first_p if first or incomplete else self.policy.next_p
        least = self.policy.least_share * self.excess
        if incomplete:
            least = min(least, self.policy.least_of_rest * (current.chi2 - current.dof))
        out = []
        for c in found:
            large = first or c.gain >= least
            predicts = not np.isfinite(before) or c.cross_validated < before
            if c.p_value < level and large and predicts and not c.refused:
                out.append(c)
        return out

    def _others(self, current: Fit) -> tuple[str, ...]:
        present = {family_of(e) for e in current.effects}
        return tuple(e for e in self.effects if e not in present)

    def _unexplained(self, current: Fit) -> bool:
        """Whether what is left is significant, and too much to call the gap explained, whatever the effects' laws are."""
        gap = lack_of_fit(current, self.noise, laws=False)
        family = lack_of_fit(current, self.noise)
        most = max(self.policy.unexplained_f, self.policy.unexplained_of_f * lack_of_fit(self.base, self.noise).f)
        much = family.f > most or current.chi2 - current.dof > self.policy.unexplained_share * self.excess
        return gap.p_value < self.policy.gap_p and much

    def _incomplete(self, current: Fit) -> bool:
        """Whether the data refute that nothing is missing any more."""
        gap = lack_of_fit(current, self.noise)
        return gap.f > self.policy.complete_f and gap.p_value < self.policy.gap_p

    def _better_pair(
        self, looked_at: Sequence[Candidate], leader: str, good: Sequence[Candidate]
    ) -> tuple[list[str], list[Candidate], tuple[Candidate, ...]] | None:
        """A pair better than the forward step's `good[0]`: its first effect, its second, and all candidates beside the first."""
        for alone, pair in self._pairs(looked_at, leader)[: self.policy.beam]:
            scale = misfit([pair, *(c.fit for c in good[:1])])
            if good and merit(pair, scale, self.policy) >= merit(good[0].fit, scale, self.policy) - 1.0:
                return None
            others = tuple(e for e in self.effects if e != family_of(alone.effect))
            second = tuple(e for e in pair.effects if e != alone.effect)
            found = self.candidates(alone.fit, others, self.policy.exchanges, beside=pair.values)
            if family_of(second[0]) not in {family_of(c.effect) for c in found}:
                found = (*found, *self.candidates(alone.fit, second, 1, beside=pair.values))
            paired = {family_of(e) for e in pair.effects}
            usable = [c for c in self.admissible(found, alone.fit) if family_of(c.effect) in paired]
            if usable:
                return [alone.effect], usable, found
        return None

    def _pairs(self, looked_at: Sequence[Candidate], leader: str) -> list[tuple[Candidate, Fit]]:
        """All pairs without `leader`, which has been seen beside every other: screened, the best refitted, best first.

        Each comes with the better of its two alone. Those that need a bound are left out.
        """
        alone = {c.effect: c for c in looked_at}
        stands_for = {family_of(e): e for e in alone}
        others = [stands_for.get(e, e) for e in self.effects if e != family_of(leader)]
        singles = [
            (c.fit, [score(c.fit, signature(c.fit, e)) for e in others if e != c.effect])
            for c in looked_at[: self.policy.beam]
            if c.effect != leader
        ]
        out = []
        for pair in screen(self.base, [signature(self.base, e) for e in others], singles)[: self.policy.pairs]:
            present = [alone[e] for e in pair.effects if e in alone]
            both = fit(self.base.frame, pair.effects, self.base.values | pair.start)
            if not present or both is None:
                continue
            ends = {leading(e, self.base.frame.unit) for e in pair.effects} & set(both.at_bound)
            if not ends or lack_of_fit(both, self.noise).p_value >= self.policy.gap_p:
                out.append((min(present, key=lambda c: c.fit.chi2), both))
        scale = misfit([f for _, f in out])
        return sorted(out, key=lambda found: merit(found[1], scale, self.policy))

    def _exchange(self, current: Fit, order: list[str], places: Places) -> tuple[Fit, list[str], Places]:
        """Backward check: each effect in turn against every other in its place, until none is better."""
        for _ in range(2 * len(order)):
            open_places = [name for name in order if name not in places]
            if not open_places:
                break
            name = open_places[0]
            others = tuple(e for e in order if e != name)
            reduced = fit(current.frame, others, current.values)
            if reduced is None:
                places[name] = ()
                continue
            found = self.candidates(reduced, self._others(reduced), self.policy.exchanges, beside=current.values)
            usable = [c for c in found if not c.refused]
            scale = misfit([current, *(c.fit for c in usable)])
            places[name] = found
            better = usable and merit(usable[0].fit, scale, self.policy) < merit(current, scale, self.policy) - 1.0
            if better and usable[0].effect != name:
                current = usable[0].fit
                order = [usable[0].effect if e == name else e for e in order]
                places = {usable[0].effect: found}
        return current, order, places

    def _steps(
        self, current: Fit, order: Sequence[str], places: Places, p_any: float
    ) -> tuple[tuple[Step, ...], tuple[Fit, ...]]:
        steps, all_rivals = [], []
        for name in order:
            found = self.refined(places.get(name, ()), name, current)
            usable = [c for c in found if not c.refused and family_of(c.effect) != family_of(name)]
            scale = misfit([current, *(c.fit for c in usable)])
            limit = merit(current, scale, self.policy) + self.policy.tie
            tied = tuple(c.effect for c in usable if merit(c.fit, scale, self.policy) <= limit)
            beyond = [merit(c.fit, scale, self.policy) - limit + self.policy.tie for c in usable if c.effect not in tied]
            stays = self._stability(current, [c.fit for c in usable], [c.effect in tied for c in usable])
            margin = min(beyond, default=np.inf)
            steps.append(Step(family_of(name), found, tuple(map(family_of, tied)), stays * (1.0 - p_any), name, stays, margin))
            all_rivals += [c.fit for c in usable if c.effect in tied]
        return tuple(steps), tuple(all_rivals)

    def prune_ambiguous(
        self, current: Fit, order: list[str], places: Places, p_any: float
    ) -> tuple[Fit, tuple[Step, ...], tuple[Fit, ...]]:
        """The fit and its steps, less the further effects that are no name, being tied with too many.

        None is left out whose absence the data refute, or which leaves the gap unexplained, unless another shape of the first
        one's law explains it.
        """
        steps, rivals = self._steps(current, by_weight(current, order), places, p_any)
        while crowded := [s.added for s in steps[1:] if 1 + len(s.equivalent) > self.policy.largest_class]:
            kept = [s.law for s in steps if s.added != crowded[-1]]
            fewer = fit(current.frame, kept, current.values)
            if fewer is None:
                break
            refuted = self._incomplete(fewer) or self._unexplained(fewer)
            if refuted and not left_by_own_law(fewer, steps, self.noise, self.excess, self.policy):
                break
            current, order, places = self._exchange(fewer, kept, {})
            steps, rivals = self._steps(current, by_weight(current, order), places, p_any)
        return current, steps, rivals

    def without_unneeded(self, current: Fit, p_any: float) -> tuple[Fit, tuple[Step, ...], tuple[Fit, ...]] | None:
        """The fit and its steps without the effect that another law of the others serves best for; None where what is left is no
        name, or where each effect is needed."""
        each = needed(current, misfit([current]), self.policy.per_parameter)
        weakest = min(each, key=lambda one: one.evidence, default=None)
        if weakest is None or weakest.evidence >= self.policy.least_evidence:
            return None
        kept = [e for e in current.effects if e != weakest.effect]
        fewer = fit(current.frame, kept, current.values)
        if fewer is None:
            return None
        fewer, found, places = self._exchange(fewer, kept, {})
        steps, rivals = self._steps(fewer, by_weight(fewer, found), places, p_any)
        return None if self.against(fewer, steps) else (fewer, steps, rivals)

    def refined(self, found: Sequence[Candidate], name: str, current: Fit) -> tuple[Candidate, ...]:
        """The candidates for the place of `name`; those that miss a tie by little are fitted from other starts."""
        scale = misfit([current, *(c.fit for c in found if not c.refused)])
        limit = merit(current, scale, self.policy) + self.policy.tie
        out, tries = [], self.policy.nearest
        for candidate in found:
            c = candidate
            beyond = merit(c.fit, scale, self.policy) - limit
            if c.effect != name and not c.refused and 0.0 < beyond < self.policy.near and tries:
                tries -= 1
                better = refit_from_restarts(c.fit)
                if merit(better, scale, self.policy) <= limit:
                    c = replace(c, fit=better, gain=c.gain + c.fit.chi2 - better.chi2)
            out.append(c)
        return tuple(sorted(out, key=lambda c: merit(c.fit, scale, self.policy)))

    def _stability(self, chosen: Fit, rivals: Sequence[Fit], tied: Sequence[bool], draws: int = 400) -> float:
        """Share of samples of the chosen model, its errors drawn anew, in which it or one tied with it is still the best."""
        if not rivals:
            return 1.0
        ratio = np.sqrt(max(chosen.integrated[0] / max(chosen.dof, 1), 1.0))
        z = ratio * errors(chosen, self.noise, self.rng, draws)
        scores: list[Array] = []
        for rival in (chosen, *rivals):
            tangent = rival.tangent()
            away = (rival.residual - chosen.residual)[:, None] - z
            away = away - tangent @ (tangent.T @ away)
            free = rival.error - tangent @ (tangent.T @ rival.error)
            along = free.T @ away
            small = np.eye(free.shape[1]) + free.T @ free
            taken = np.sum(along * np.linalg.solve(small, along), axis=0)
            scores.append(np.sum(away**2, axis=0) - taken + rival.integrated[1])
        winner = np.argmin(np.stack(scores), axis=0)
        return float(np.mean(np.array([True, *tied])[winner]))
