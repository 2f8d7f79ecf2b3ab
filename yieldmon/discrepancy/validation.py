"""Validation of the named effects on rows that were not fitted; only confirmed effects are named.

The readings are projected on the line from the published model's prediction (share 0) to that with the named effects (share 1).
Their share has a standard deviation by noise and the model error. Above one half the effects reduce the misfit. The rows are
those held out before the search, and the others with each one left out in turn (cross-fitting; Chernozhukov et al., Econometrics
Journal 21, 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from yieldmon.estimation import model_error
from yieldmon.estimation.gaussian import REACH_90
from yieldmon.physics.numerics import Array

from .fit import Fit

FOLDS = 5
_HELD_OUT = 1.282
"""Least distance of the held-out rows alone from share 0, in standard deviations."""
_REGION = 3.0
"""Distance below one half, in standard deviations, from which a region is worse than before."""


@dataclass(frozen=True, slots=True)
class Share:
    """Position of readings between two predictions, 0 to 1. power: sum of squares of the difference between the two."""

    value: float
    sd: float
    power: float


@dataclass(frozen=True, slots=True)
class Validation:
    """Result on rows that were not fitted.

    held_out: share on the held-out rows (None: there are none). cross_fitted: share on all rows, each with a fit without it.
    worse: names of regions that are worse with the effects. agrees: whether the effects are confirmed.
    """

    held_out: Share | None
    cross_fitted: Share
    worse: tuple[str, ...]
    agrees: bool


def share(before: Array, after: Array, error: Array) -> Share:
    """Share from whitened residuals (prediction minus reading) of the two predictions, shape (rows,).

    error: whitened columns of the model error with unit weights, (rows, columns).
    """
    between = after - before
    power = float(between @ between)
    if power <= 0.0:
        return Share(0.5, float("inf"), 0.0)
    spread = max(float(np.mean(after**2)), 1.0)
    variance = spread / power + float(np.sum((error.T @ between) ** 2)) / power**2
    return Share(float(-(between @ before)) / power, float(np.sqrt(variance)), power)


def pooled(parts: list[Share]) -> Share:
    """Mean share of independent groups of rows, weighted by their power."""
    power = sum(p.power for p in parts)
    if power <= 0.0:
        return Share(0.5, float("inf"), 0.0)
    weight = np.array([p.power / power for p in parts])
    known = weight > 0.0
    value = float(np.sum(weight * np.array([p.value for p in parts])))
    return Share(value, float(np.sqrt(np.sum((weight[known] * np.array([p.sd for p in parts])[known]) ** 2))), power)


def validate(base: Fit, best: Fit, held_out: Share | None, rng: np.random.Generator) -> Validation:
    """Compare `best` with `base`, both fitted to the other rows."""
    cells = len(base.residual)
    fold = rng.permutation(np.arange(cells) % min(FOLDS, cells))
    before, after = (model_error.left_out(f.residual, f.tangent(), fold) for f in (base, best))
    open_rows = share(before, after, best.own_error)
    cross_fitted = pooled([open_rows, *([held_out] if held_out is not None else [])])
    worse = []
    for name, numbers in base.frame.cells.groups().items():
        for number in range(int(numbers.max()) + 1):
            inside: NDArray[np.bool_] = numbers == number
            here = share(before[inside], after[inside], best.error[inside])
            if here.value + _REGION * here.sd < 0.5:
                worse.append(f"{name} {number + 1}")
    agrees = cross_fitted.value - REACH_90 * cross_fitted.sd > 0.5 and not worse
    if held_out is not None and held_out.power > 1.0:
        agrees = agrees and held_out.value - _HELD_OUT * held_out.sd > 0.0
    return Validation(held_out, cross_fitted, tuple(worse), bool(agrees))


def mean_square_interval(mean_square: float, rows: int) -> tuple[float, float]:
    """95 % interval of a mean square of `rows` whitened residuals."""
    low, high = float(scipy.stats.chi2.ppf(0.975, rows)), float(scipy.stats.chi2.ppf(0.025, rows))
    return mean_square * rows / low, mean_square * rows / high
