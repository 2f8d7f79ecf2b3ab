"""Change of the force in each cell by an effect of several sizes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from yieldmon.discrepancy.fit import Fit
from yieldmon.discrepancy.frame import Parameter, effect_parameters, predictions
from yieldmon.physics.effects import family_of, get_effect
from yieldmon.physics.numerics import Array, real

SIZES = (0.1, 0.2, 0.35, 0.6, 1.0, 1.7, 3.0, 5.0)
"""Sizes at which a change is computed, in typical sizes from the null value."""
_UNLIKELY = 2.0 * float(np.log(20.0))
"""-2 log of the prior odds that an effect `of_grain` occurs at one machine alone."""


@dataclass(frozen=True)
class ForceChange:
    """Change of ln(force) in each cell by an effect at several points: points (points, parameters), change (points, cells)."""

    law: str
    parameters: tuple[Parameter, ...]
    points: Array
    change: Array


@dataclass(frozen=True)
class Guess:
    """A point of a change, and the best-fitting share of its distance from the null value."""

    change: ForceChange
    point: int
    share: float

    @property
    def values(self) -> dict[str, float]:
        """Values of the effect's parameters, within their bounds."""
        c = self.change
        moved = {p.name: p.start + self.share * (v - p.start) for p, v in zip(c.parameters, c.points[self.point], strict=True)}
        return {p.name: float(np.clip(moved[p.name], p.lower, p.upper)) for p in c.parameters}

    def surprise(self, length: float) -> float:
        """-2 log of its prior probability.

        Sizes have a Cauchy prior with the effect's prior width (Jeffreys), and the likelihood is integrated over them (Laplace).
        So for a small change, an effect that is usually small is preferred to one that is usually a hundred times larger. Effects
        of grain are unlikely at a single machine.

        length: of its change, in standard deviations; it determines the width of the likelihood over the size.
        """
        cost = get_effect(family_of(self.change.law)).of_grain * _UNLIKELY
        for p, value in zip(self.change.parameters, self.change.points[self.point], strict=True):
            size = abs(self.share * (value - p.start))
            if size == 0.0 or not np.isfinite(p.prior_sd):
                continue
            sides = 1.0 if p.lower < p.start < p.upper else 2.0
            density = sides / (np.pi * p.prior_sd * (1.0 + (size / p.prior_sd) ** 2))
            cost -= 2.0 * np.log(density * np.sqrt(2.0 * np.pi) * size / max(length, 1e-9))
        return float(cost)


@dataclass(frozen=True)
class Visible:
    """Smallest distance from its null value at which an effect of a single machine is found in 80 of 100 fleets; inf if at no
    physical size.

    parameter: the leading parameter of the effect.
    """

    effect: str
    parameter: str
    size: float
    unit: str


def force_change(known: Fit, law: str) -> ForceChange | None:
    """Changes of a fitted model by a law, starting at its present parameters; None if there is no prediction in any cell."""
    frame = known.frame
    at = dict(known.values)
    effects = known.effects if law in known.effects else (*known.effects, law)
    parameters = tuple(replace(p, start=at[p.name]) if p.name in at else p for p in effect_parameters(law, frame.unit))
    points = []
    for i, p in enumerate(parameters):
        size = p.scale
        for share, sense in product(SIZES, (1.0, -1.0)):
            value = p.start + sense * share * size
            if p.lower <= value <= p.upper:
                points.append([value if k == i else q.start for k, q in enumerate(parameters)])
    if not points:
        return None
    drawn = np.array(points)
    batch: dict[str, ArrayLike] = {**at, **{p.name: drawn[:, i, None] for i, p in enumerate(parameters)}}
    without = real(predictions(frame, known.effects, at))
    with np.errstate(invalid="ignore", divide="ignore"):
        change = np.log(np.broadcast_to(real(predictions(frame, effects, batch)), (len(drawn), len(frame.cells))) / without)
    usable = np.all(np.isfinite(change), axis=1)
    if not np.any(usable):
        return None
    return ForceChange(law, parameters, drawn[usable], change[usable])


def visible_size(drawn: ForceChange, length: Array, needed: float) -> Visible:
    """Smallest detectable size of an effect.

    length: of its change at each of its points, in standard deviations, (points,). needed: the detectable length.
    """
    leading, rest = drawn.parameters[0], np.array([p.start for p in drawn.parameters[1:]])
    alone = np.all(drawn.points[:, 1:] == rest, axis=1) & (length > 1e-6)
    step = np.abs(drawn.points[alone, 0] - leading.start)
    size = float("inf")
    if step.size:
        # A change is nonlinear in size: the point nearest to its own result is used.
        answers = step * needed / length[alone]
        size = float(answers[np.argmin(np.abs(np.log(answers / step)))])
    physical = size <= max(leading.upper - leading.start, leading.start - leading.lower)
    return Visible(family_of(drawn.law), leading.name.partition(".")[2], size if physical else float("inf"), leading.unit)
