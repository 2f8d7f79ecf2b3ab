"""Result of a search for missing effects: candidates, steps, verdict."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from yieldmon.documents.diagnose import Verdict

from .fit import Fit
from .lack_of_fit import LackOfFit
from .policy import Policy


@dataclass(frozen=True)
class Candidate:
    """One candidate at one step: its refit, gain in chi-square, and global p value; refused if it needs a bound.

    beyond_laws: the gain that other shapes of the present effects' laws would not give (`candidates.gained`).
    """

    effect: str
    fit: Fit
    gain: float
    p_value: float
    cross_validated: float
    refused: str = ""
    beyond_laws: float = 0.0


@dataclass(frozen=True)
class Step:
    """One added effect: candidates in the order of their merit, and those that the data cannot distinguish from the first."""

    added: str
    candidates: tuple[Candidate, ...]
    equivalent: tuple[str, ...]
    confidence: float
    """nan: not known, of leading candidates only."""
    law: str
    """The law with which it was fitted, as in `Fit.effects`."""
    stability: float = 1.0
    """Share of samples with new random errors in which the effect, or one tied with it, is still the best."""
    margin: float = float("inf")
    """Difference of -2 log evidence to the best candidate that is not tied; inf if there is none."""
    name_confidence: float = float("nan")
    """Probability that the cause is this effect, and not one tied with it."""


@dataclass(frozen=True)
class Choice:
    """The verdict ("effect", "none", "unknown") with the fits behind it; `partial` holds what helps but does not explain."""

    verdict: Verdict
    base: Fit
    best: Fit
    lack_of_fit_before: LackOfFit
    lack_of_fit_after: LackOfFit
    steps: tuple[Step, ...]
    looked_at: tuple[Candidate, ...]
    """Candidates of the first step."""
    p_any: float
    """Global p value of the strongest candidate."""
    rivals: tuple[Fit, ...] = field(default=())
    objection: str = ""
    """Why the steps are only candidates if the verdict is "unknown"."""

    @property
    def named(self) -> tuple[str, ...]:
        """Effects in the order they were added; empty unless the verdict is "effect"."""
        return tuple(step.added for step in self.steps) if self.verdict == "effect" else ()


def withdrawn(choice: Choice, policy: Policy) -> Choice:
    """The choice after its named effects were not confirmed: verdict "unknown" if a misfit is left, else "none"."""
    verdict: Verdict = "unknown" if choice.lack_of_fit_before.p_value < policy.lack_of_fit_p else "none"
    return replace(choice, verdict=verdict)


def rows_searched(found: Fit) -> str:
    """The rows on which a fit of the search is judged; fewer than all if some are held out."""
    return f"on the {len(found.frame.cells.rows)} rows searched"
