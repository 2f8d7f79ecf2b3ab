"""Thresholds by which effects are searched for and named."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Policy:
    """Thresholds of the decision; defaults checked by studies/hidden_effects on cases with a known answer."""

    most_effects: int = 3
    first_p: float = 0.02
    """Global false-alarm rate of naming anything at all."""
    next_p: float = 0.002
    """The same for each further effect, where the model so far may be complete."""
    least_confidence: float = 0.2
    """Probability of being right below which the first effect is a leading candidate and no name: so many effects fit such rows
    that one alone is no evidence. A name carries its probability; what separates wrong from right ones is `Objections`."""
    complete_f: float = 2.0
    """Lack of fit up to which it may be: above it and below `lack_of_fit_p` not, and `first_p` holds for a further effect."""
    lack_of_fit_p: float = 0.01
    """Lack of fit with a p value below this is significant."""
    least_share: float = 0.02
    """Share of the original excess chi-square that a further effect must explain, or else"""
    least_of_rest: float = 0.5
    """this share of what is left, where the data refute that nothing is missing any more."""
    unexplained_f: float = 3.5
    """Lack of fit above which the misfit is not called explained, unless it is less than"""
    unexplained_of_f: float = 0.01
    """this share of the published model's: a cause whose law is off by so little is named all the same."""
    unexplained_share: float = 0.15
    """Share of the original excess chi-square that may remain under a named verdict, significant or not."""
    own_law_share: float = 0.05
    """Share of the original excess up to which a misfit may be another shape of the law of one effect, far ahead of others."""
    least_evidence: float = 0.0
    """Twice the log evidence for each of several effects that is needed against another law of the others."""
    most_cancelled: float = 0.5
    """Share of what several effects change that may cancel among themselves: beyond, they are terms of a series and no causes,
    unless other laws of the others could not serve either."""
    tie: float = 6.0
    """Chi-square distance (over the best one's misfit, where above 1) within which the data do not distinguish two effects."""
    near: float = 30.0
    """Chi-square (over the misfit) beyond a tie within which a rival is fitted from other starts before it is ruled out."""
    nearest: int = 6
    """At most so many of them, the best first."""
    largest_class: int = 5
    """Effects that a class may hold and still count as a name (see `Search.prune_ambiguous` for a further effect's)."""
    per_parameter: float = 3.0
    """Chi-square that each further parameter must earn."""
    refits: int = 24
    """Candidates refitted at a step, the best by signature."""
    bound_allowance: float = 4.0
    """Chi-square (over the misfit) that leaving a bound may cost an effect that is not refused for it."""
    beam: int = 6
    """First-step candidates, refused ones too, beside which a second is screened where the first leaves a misfit; pairs tried."""
    pairs: int = 12
    """Pairs refitted, the best by screening."""
    exchanges: int = 8
    """Candidates refitted at each exchange."""
    starts: int = 1
    """Starts of each refit."""
    law_share: float = 0.5
    """Share of an effect's best screened gain that another of its laws must promise to be fitted."""
    short_search: int = 6
    """Steps after which a candidate's refit is judged for the first time."""
    hopeless: float = 60.0
    """Chi-square (over the misfit), beside a quarter of the best one's gain, behind the best from which it is not taken on."""


DEFAULT = Policy()
