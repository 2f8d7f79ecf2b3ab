"""Thresholds for the search and the naming of effects."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Policy:
    """Thresholds of the decision; defaults checked by studies/hidden_effects on cases with a known answer."""

    most_effects: int = 3
    first_p: float = 0.02
    """Global false-alarm rate of naming anything at all."""
    next_p: float = 0.002
    """The same for each further effect, if the present model may be complete."""
    least_confidence: float = 0.2
    """Probability of being right below which the first effect is only a leading candidate, because many effects fit such rows. A
    name is stated with its probability; wrong names are mainly rejected by `Objections`."""
    complete_f: float = 2.0
    """Largest lack of fit of a model that may be complete. Above it, with a p value below `lack_of_fit_p`, the model is
    incomplete, and `first_p` holds for a further effect."""
    lack_of_fit_p: float = 0.01
    """Lack of fit with a p value below this is significant."""
    least_share: float = 0.02
    """Share of the original excess chi-square that a further effect must explain, or else"""
    least_of_rest: float = 0.5
    """this share of the remaining excess, if the data show that an effect is still missing."""
    unexplained_f: float = 3.5
    """Lack of fit above which the misfit is not called explained, unless it is less than"""
    unexplained_of_f: float = 0.01
    """this share of the published model's, since a cause is named in spite of such a small error of its law."""
    unexplained_share: float = 0.15
    """Share of the original excess chi-square that may remain under a named verdict, significant or not."""
    own_law_share: float = 0.05
    """Share of the original excess up to which a misfit may be attributed to the law of one effect that is far better than
    others."""
    least_evidence: float = 0.0
    """Least twice the log evidence for each of several effects against another law of the others."""
    most_cancelled: float = 0.5
    """Largest share of the changes by several effects that may cancel out between them. Beyond it they are terms of a series and
    not causes, unless other laws of the other effects explain the rows no better."""
    tie: float = 6.0
    """Chi-square distance (over the best one's misfit, where above 1) within which the data do not distinguish two effects."""
    near: float = 30.0
    """Chi-square (over the misfit) beyond a tie within which a rival is fitted from other starts before it is excluded."""
    nearest: int = 6
    """Largest number of these rivals, the best first."""
    largest_class: int = 5
    """Largest number of tied effects that still count as a name (see `Search.prune_ambiguous` for further effects)."""
    per_parameter: float = 3.0
    """Chi-square that each further parameter must gain."""
    refits: int = 24
    """Number of candidates that are refitted at a step, the best by signature."""
    bound_allowance: float = 4.0
    """Largest increase of chi-square (over the misfit) on leaving a bound with which an effect is not refused."""
    beam: int = 6
    """Number of first-step candidates, including refused ones, for which pairs with a second effect are screened if a misfit is
    left."""
    pairs: int = 12
    """Number of pairs that are refitted, the best by screening."""
    exchanges: int = 8
    """Number of candidates that are refitted at each exchange."""
    starts: int = 1
    """Number of starts of each refit."""
    law_share: float = 0.5
    """Least ratio of a law's screened gain to that of the effect's best law with which it is fitted."""
    short_search: int = 6
    """Number of steps after which a candidate's refit is first compared with others."""
    hopeless: float = 60.0
    """Distance in chi-square (over the misfit) from the best one, in addition to a quarter of its gain, from which a refit is
    stopped."""


DEFAULT = Policy()
