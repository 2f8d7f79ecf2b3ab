"""Confidence in a named effect as a probability, calibrated on cases with known answers.

A logistic function maps features of a search to the share of correct names. It was fitted to the cases of
`studies/hidden_effects`, whose generators have no law in common with the library; the file states the cases and the commit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from math import nan

import numpy as np

from yieldmon.physics.numerics import Array

from .choice import Choice, Step
from .fit import Fit
from .policy import Policy

FEATURES = ("stability", "margin", "misfit", "strength", "further", "effects", "against")
"""Inputs of the logistic function, see `features`."""
_REACH = 2.0
_FAR = 60.0
"""Margin above which a larger one has no further influence."""
_MOST_LEFT = 0.7
"""Share of the excess left by candidates beyond which hardly a case was calibrated on, so that no confidence is stated."""
MOST_BESIDE_BOUND = 0.65
"""Largest confidence if a parameter of the grain ends at a bound beside the effects. Of 111 such names in the studies' cases for
which 0.6 to 0.98 was stated, 0.83 in the mean, 74 were right."""
MOST_AT_BOUND = 0.45
"""Largest confidence if the size of the effect, or two parameters of the grain, end at a bound. Hardly any name of the studies'
cases does, so how often these are right is not known."""


@dataclass(frozen=True, slots=True)
class Logistic:
    """1 / (1 + exp(-(bias + weights . (features - centre) / scale)))."""

    centre: Array
    scale: Array
    weights: Array
    bias: float

    def __call__(self, rows: Array) -> Array:
        """Probabilities, (n,), of features, (n, features)."""
        # Limited to the range of the calibration cases.
        z = self.bias + np.clip((rows - self.centre) / self.scale, -_REACH, _REACH) @ self.weights
        return np.asarray(1.0 / (1.0 + np.exp(-z)))


@dataclass(frozen=True, slots=True)
class Calibration:
    """within: probability that the effect or one tied with it is the cause. name: that it is the effect itself, given the
    former."""

    within: Logistic
    name: Logistic
    provenance: Mapping[str, object]


def features(choice: Choice) -> list[dict[str, float]]:
    """Features of each step of a choice, by name; contains those in `FEATURES`."""
    excess = max(choice.base.chi2 - choice.base.dof, 1.0)
    left = max(choice.best.chi2 - choice.best.dof, 0.0)
    return [
        {
            "stability": step.stability,
            "margin": float(np.log1p(min(max(step.margin, 0.0), _FAR))),
            "misfit": float(np.log(np.clip(choice.lack_of_fit_after.f, 0.5, 50.0))),
            "left_share": float(np.sqrt(min(left / excess, 1.0))),
            "strength": float(np.log(np.sqrt(excess))),
            "ties": float(len(step.equivalent)),
            "further": float(number > 0),
            "effects": float(len(choice.steps)),
            "against": float(bool(choice.objection)),
        }
        for number, step in enumerate(choice.steps)
    ]


def as_rows(found: Sequence[Mapping[str, float]]) -> Array:
    """Features as an array, (n, features)."""
    return np.array([[f[name] for name in FEATURES] for f in found], dtype=float).reshape(len(found), len(FEATURES))


def from_document(document: Mapping[str, object]) -> Calibration:
    """Read the calibration from the shipped document. Raises KeyError if a feature is missing."""

    def one(part: object) -> Logistic:
        assert isinstance(part, Mapping)
        columns = [part["features"][name] for name in FEATURES]
        centre, scale, weight = (np.array([c[key] for c in columns]) for key in ("centre", "scale", "weight"))
        return Logistic(centre, scale, weight, float(part["bias"]))

    provenance = document["provenance"]
    assert isinstance(provenance, Mapping)
    return Calibration(one(document["within"]), one(document["name"]), provenance)


@lru_cache(maxsize=1)
def shipped() -> Calibration:
    """The calibration that comes with the package."""
    return from_document(json.loads(files(__package__).joinpath("confidence.json").read_text(encoding="utf-8")))


def calibrated(choice: Choice, by: Calibration) -> Choice:
    """The choice with each step's confidence as a probability; nan where hardly a case of the calibration is like it."""
    if not choice.steps:
        return choice
    found = features(choice)
    if found[0]["left_share"] ** 2 > _MOST_LEFT:
        return without_confidence(choice)
    rows = as_rows(found)
    within = by.within(rows)
    # Without ties the name is the whole class.
    alone = np.array([not step.equivalent for step in choice.steps])
    names = within * np.where(alone, 1.0, by.name(rows))
    steps = tuple(
        replace(step, confidence=float(c), name_confidence=float(n))
        for step, c, n in zip(choice.steps, within, names, strict=True)
    )
    return replace(choice, steps=steps)


def limited(choice: Choice, found: Fit) -> Choice:
    """The choice with no more confidence than the parameters of its fit that end at a bound allow; itself if they take nothing
    from it."""
    grain = sum(p.name in found.at_bound for p in found.frame.base)
    beside = (1.0, MOST_BESIDE_BOUND, MOST_AT_BOUND)[min(grain, 2)]
    ended = {name.partition(".")[0] for name in found.leading_at_bound}
    steps = tuple(_at_most(step, min(beside, MOST_AT_BOUND) if step.law in ended else beside) for step in choice.steps)
    return choice if steps == choice.steps else replace(choice, steps=steps)


def _at_most(step: Step, most: float) -> Step:
    if not step.confidence > most:
        return step
    return replace(step, confidence=most, name_confidence=step.name_confidence * most / step.confidence)


def without_confidence(choice: Choice) -> Choice:
    """The choice with nan as each step's confidence: the calibration holds no cases like it."""
    return replace(choice, steps=tuple(replace(step, confidence=nan, name_confidence=nan) for step in choice.steps))


def doubted(choice: Choice, policy: Policy) -> bool:
    """Whether the probability of the first name is too low for a name."""
    return choice.verdict == "effect" and choice.steps[0].confidence < policy.least_confidence
