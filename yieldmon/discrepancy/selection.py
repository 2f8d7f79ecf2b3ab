"""Selection of effects: forward steps with exchange, a global false-alarm rate, ties, and the verdict "unknown".

An effect is tested as a family of laws: errors of its law (`Fit.shape_error`) and the model error are integrated out, so that
neither a tie nor a misfit depends on one particular law.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.documents.diagnose import Verdict
from yieldmon.physics.effects import family_of
from yieldmon.physics.numerics import Array

from .alternatives import chosen_from_all, needed
from .candidates import (
    Score,
    errors,
    false_alarm,
    gained,
    lawful,
    leading,
    only_at_bound,
    polished,
    refit,
    refit_from_restarts,
    score,
    second,
    signature,
)
from .choice import Candidate, Choice, Step
from .crossvalidation import grouped_error
from .fit import Fit, fit
from .lack_of_fit import lack_of_fit
from .merit import by_weight, left_by_own_law, merit, misfit
from .noise import Noise
from .objections import Objections
from .pairs import screen
from .policy import DEFAULT, Policy

_DRAWS = 400
"""Number of random samples for the stability of the chosen model."""
Progress = Callable[[str, float], None]
"""Called with the present step and the share that is done, 0 to 1."""
Places = dict[str, tuple[Candidate, ...]]
"""The last candidates for the place of each effect, given the other present ones."""


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


@dataclass(frozen=True)
class Explanation:
    """A fit with the steps that added its effects, and the fits with effects tied with these."""

    fit: Fit
    steps: tuple[Step, ...]
    rivals: tuple[Fit, ...]


@dataclass(frozen=True, kw_only=True)
class Search:
    """One search through a library of effects.

    Parameters
    ----------
    base
        The fitted published model.
    noise
        Noise of the rows.
    effects
        Names to choose from.
    rng
        Generator for Monte Carlo.
    policy
        Thresholds.
    """

    base: Fit
    noise: Noise
    effects: tuple[str, ...]
    rng: np.random.Generator
    policy: Policy = DEFAULT

    @property
    def objections(self) -> Objections:
        """Objections to naming the effects found."""
        return Objections(base=self.base, noise=self.noise, policy=self.policy)

    def run(self, report: Progress) -> Choice:
        """The whole search."""
        lack_of_fit_before = lack_of_fit(self.base, self.noise)
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
            if number == 1 and lack_of_fit(current, self.noise).p_value < self.policy.lack_of_fit_p:
                report("step 2: all pairs", 0.45)
                better = self._better_pair(looked_at, order[0], good[0].fit if good else current)
                if better is not None:
                    leader, good, found = better
            if not good:
                break
            current, order, places = good[0].fit, [*leader, good[0].effect], {good[0].effect: found}
            if number > 0:
                report(f"step {number + 1}: exchange", (number + 0.6) / self.policy.most_effects)
                current, order, places = self._exchange(current, order, places)
            if lack_of_fit(current, self.noise).p_value < self.policy.lack_of_fit_p:
                current = refit_from_restarts(current)
        if not order:
            verdict: Verdict = "unknown" if lack_of_fit_before.p_value < self.policy.lack_of_fit_p else "none"
            return Choice(
                verdict=verdict,
                base=self.base,
                best=self.base,
                lack_of_fit_before=lack_of_fit_before,
                lack_of_fit_after=lack_of_fit_before,
                steps=(),
                looked_at=looked_at,
                p_any=p_any,
            )
        named = self.prune_ambiguous(current, order, places, p_any)
        objection = self.objections.first(named.fit, named.steps)
        if objection and (fewer := self.without_unneeded(named.fit, p_any)) is not None:
            named, objection = fewer, ""
        verdict = "unknown" if objection else "effect"
        test = lack_of_fit(named.fit, self.noise)
        return Choice(
            verdict=verdict,
            base=self.base,
            best=named.fit,
            lack_of_fit_before=lack_of_fit_before,
            lack_of_fit_after=test,
            steps=named.steps,
            looked_at=looked_at,
            p_any=p_any,
            rivals=named.rivals,
            objection=objection,
        )

    def candidates(
        self,
        current: Fit,
        effects: Sequence[str],
        refits: int,
        *,
        beside: Mapping[str, float] | None = None,
    ) -> tuple[Candidate, ...]:
        """The `refits` most promising effects, refitted (also from `beside`, see `candidates.refit`), best first.

        Each has its best law.
        """
        signatures = [signature(current, law) for law in lawful(effects)]
        p_value = false_alarm(signatures, current, self.noise, self.rng)
        worth = self._by_family([score(current, s) for s in signatures])[:refits]
        groups = current.frame.cells.groups()
        out = []
        for s, added in self._fitted(current, worth, beside):
            gain = current.chi2 - added.chi2
            # Ending at a bound is no evidence against the effect unless the data contradict the bound.
            complete = lack_of_fit(added, self.noise).p_value >= self.policy.lack_of_fit_p
            refused = "" if complete else only_at_bound(added, s.effect, self.policy.bound_allowance)
            missed = grouped_error(added, groups)
            unseen = float(np.mean(list(missed.values()) or [np.nan]))
            p = p_value(gained(current, added))
            out.append(
                Candidate(
                    effect=s.effect,
                    fit=added,
                    gain=gain,
                    p_value=p,
                    cross_validated=unseen,
                    refused=refused,
                    beyond_laws=gained(current, added, own=True),
                )
            )
        scale = misfit([c.fit for c in out])
        return tuple(sorted(out, key=lambda c: merit(c.fit, scale, self.policy)))

    def _by_family(self, scores: Iterable[Score]) -> list[list[Score]]:
        """Scores grouped by effect, the most promising effect and law first; laws that are far worse are left out."""
        families: dict[str, list[Score]] = {}
        for s in sorted(scores, key=lambda s: -s.gain):
            families.setdefault(family_of(s.effect), []).append(s)
        return [[s for s in of if s.gain >= self.policy.law_share * of[0].gain] for of in families.values()]

    def _fitted(
        self, current: Fit, worth: Sequence[Sequence[Score]], beside: Mapping[str, float] | None
    ) -> list[tuple[Score, Fit]]:
        """Each effect's refit with its best law. The fit of a law that is far worse after a few steps is stopped."""
        short = self.policy.short_search
        begun: list[list[tuple[Score, Fit]]] = []
        for of_family in worth:
            rough = [(s, refit(current, s, starts=self.policy.starts, beside=beside, iterations=short)) for s in of_family]
            begun.append([(s, f) for s, f in rough if f is not None])
        each = [f for laws in begun for _, f in laws]
        scale, least = misfit(each), min((f.chi2 for f in each), default=0.0)
        limit = least + self.policy.hopeless * scale + 0.25 * (current.chi2 - least)
        # A few steps are not enough to rank the laws of one effect.
        ended = [[(s, polished(f) if f.chi2 <= limit else f) for s, f in laws] for laws in begun if laws]
        dear = self.policy.per_parameter
        return [min(laws, key=lambda found: found[1].chi2 + dear * len(found[1].shapes)) for laws in ended]

    def admissible(self, found: Sequence[Candidate], current: Fit) -> list[Candidate]:
        """Candidates that may be added to `current`: significant, large enough, predictive, within bounds."""
        groups = current.frame.cells.groups()
        before = float(np.mean(list(grouped_error(current, groups).values()) or [np.nan]))
        first, beside_one = not current.effects, second(current)
        incomplete = self.objections.incomplete(current)
        level = self.policy.first_p if first or incomplete else self.policy.next_p
        least = self.policy.least_share * self.objections.excess
        if incomplete:
            least = min(least, self.policy.least_of_rest * (current.chi2 - current.dof))
        out = []
        for c in found:
            large = first or c.gain >= least or (beside_one and c.beyond_laws >= chosen_from_all(self.policy.per_parameter))
            predicts = not np.isfinite(before) or c.cross_validated < before
            if c.p_value < level and large and predicts and not c.refused:
                out.append(c)
        return out

    def _others(self, current: Fit) -> tuple[str, ...]:
        present = {family_of(e) for e in current.effects}
        return tuple(e for e in self.effects if e not in present)

    def _better_pair(
        self, looked_at: Sequence[Candidate], leader: str, forward: Fit
    ) -> tuple[list[str], list[Candidate], tuple[Candidate, ...]] | None:
        """A pair better than `forward`, the result of the forward steps: its first effect, its second, and all candidates given
        the first."""
        for alone, pair in self._pairs(looked_at, leader)[: self.policy.beam]:
            scale = misfit([pair, forward])
            if merit(pair, scale, self.policy) >= merit(forward, scale, self.policy) - 1.0:
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
        """Pairs without `leader`, which has been combined with all others already: screened, the best refitted, best first.

        Each is returned with the better of its two effects alone. Pairs that need a bound are left out.
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
            if not ends or lack_of_fit(both, self.noise).p_value >= self.policy.lack_of_fit_p:
                out.append((min(present, key=lambda c: c.fit.chi2), both))
        scale = misfit([f for _, f in out])
        return sorted(out, key=lambda found: merit(found[1], scale, self.policy))

    def _exchange(self, current: Fit, order: list[str], places: Places) -> tuple[Fit, list[str], Places]:
        """Backward check: each effect in turn is compared with every other one in its place, until none is better."""
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
            steps.append(
                Step(
                    added=family_of(name),
                    candidates=found,
                    equivalent=tuple(map(family_of, tied)),
                    confidence=stays * (1.0 - p_any),
                    law=name,
                    stability=stays,
                    margin=margin,
                )
            )
            all_rivals += [c.fit for c in usable if c.effect in tied]
        return tuple(steps), tuple(all_rivals)

    def prune_ambiguous(self, current: Fit, order: list[str], places: Places, p_any: float) -> Explanation:
        """The fit and its steps without further effects that are tied with too many others for a name.

        An effect is kept if the data contradict its absence, or the misfit is unexplained without it, unless another shape of the
        first one's law explains that misfit.
        """
        steps, rivals = self._steps(current, by_weight(current, order), places, p_any)
        while crowded := [s.added for s in steps[1:] if 1 + len(s.equivalent) > self.policy.largest_class]:
            kept = [s.law for s in steps if s.added != crowded[-1]]
            fewer = fit(current.frame, kept, current.values)
            if fewer is None:
                break
            refuted = self.objections.incomplete(fewer) or self.objections.unexplained(fewer)
            if refuted and not left_by_own_law(fewer, steps, self.noise, self.objections.excess, self.policy):
                break
            current, order, places = self._exchange(fewer, kept, {})
            steps, rivals = self._steps(current, by_weight(current, order), places, p_any)
        return Explanation(current, steps, rivals)

    def without_unneeded(self, current: Fit, p_any: float) -> Explanation | None:
        """The fit and its steps without the effect that other laws of the others replace best; None if each effect is needed, or
        there is an objection to naming the others."""
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
        return None if self.objections.first(fewer, steps) else Explanation(fewer, steps, rivals)

    def refined(self, found: Sequence[Candidate], name: str, current: Fit) -> tuple[Candidate, ...]:
        """The candidates for the place of `name`. Those that are nearly tied are fitted from other starts."""
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

    def _stability(self, chosen: Fit, rivals: Sequence[Fit], tied: Sequence[bool]) -> float:
        """Share of samples of the chosen model with new random errors in which it, or one tied with it, is still the best."""
        if not rivals:
            return 1.0
        ratio = np.sqrt(max(chosen.integrated[0] / max(chosen.dof, 1), 1.0))
        z = ratio * errors(chosen, self.noise, self.rng, _DRAWS)
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
