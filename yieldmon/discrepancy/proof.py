"""Whether rows that a fit has not seen agree with what it names; their answer decides.

Along the line from the published model's prediction (share 0) to that with the named effects (share 1) the unseen readings lie at
some share, with a standard deviation from noise and from the model's own error. Above one half the effects close part of the gap.
The rows are those sealed before the search, and the others, each left out in turn (cross-fitting; Chernozhukov et al.,
Econometrics Journal 21, 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from yieldmon.estimation import model_error
from yieldmon.physics.numerics import Array

from .fit import Fit

FOLDS = 5
_ONE_SIDED = 1.645
_SEALED = 1.282
"""Standard deviations that the sealed rows alone must lie above a share of 0."""
_REGION = 3.0
"""Standard deviations below one half from which a region is worse than before."""


@dataclass(frozen=True, slots=True)
class Share:
    """Where unseen readings lie between two predictions, 0 to 1; power: sum of squares between the two."""

    value: float
    sd: float
    power: float


@dataclass(frozen=True, slots=True)
class Proof:
    """What unseen rows say of named effects.

    sealed: by the rows set aside (None: none). crossed: by all rows, each unseen by the fit that judges it. worse: names
    of regions that are worse with the effects. agrees: the verdict.
    """

    sealed: Share | None
    crossed: Share
    worse: tuple[str, ...]
    agrees: bool


def share(before: Array, after: Array, error: Array) -> Share:
    """Share from whitened residuals (prediction minus reading) of the two predictions, shape (rows,).

    error: whitened columns of the model's own error with unit weights, shape (rows, columns).
    """
    between = after - before
    power = float(between @ between)
    if power <= 0.0:
        return Share(0.5, float("inf"), 0.0)
    spread = max(float(np.mean(after**2)), 1.0)
    variance = spread / power + float(np.sum((error.T @ between) ** 2)) / power**2
    return Share(float(-(between @ before)) / power, float(np.sqrt(variance)), power)


def pooled(parts: list[Share]) -> Share:
    """The shares of independent rows together, by their power."""
    power = sum(p.power for p in parts)
    if power <= 0.0:
        return Share(0.5, float("inf"), 0.0)
    weight = np.array([p.power / power for p in parts])
    known = weight > 0.0
    value = float(np.sum(weight * np.array([p.value for p in parts])))
    return Share(value, float(np.sqrt(np.sum((weight[known] * np.array([p.sd for p in parts])[known]) ** 2))), power)


def prove(base: Fit, best: Fit, sealed: Share | None, rng: np.random.Generator) -> Proof:
    """Judge `best` against `base`; both fitted to the unsealed rows."""
    cells = len(base.residual)
    fold = rng.permutation(np.arange(cells) % min(FOLDS, cells))
    before, after = (model_error.left_out(f.residual, f.tangent(), fold) for f in (base, best))
    open_rows = share(before, after, best.own_error)
    crossed = pooled([open_rows, *([sealed] if sealed is not None else [])])
    worse = []
    for name, numbers in base.frame.cells.groups().items():
        for number in range(int(numbers.max()) + 1):
            inside: NDArray[np.bool_] = numbers == number
            here = share(before[inside], after[inside], best.error[inside])
            if here.value + _REGION * here.sd < 0.5:
                worse.append(f"{name} {number + 1}")
    agrees = crossed.value - _ONE_SIDED * crossed.sd > 0.5 and not worse
    if sealed is not None and sealed.power > 1.0:
        agrees = agrees and sealed.value - _SEALED * sealed.sd > 0.0
    return Proof(sealed, crossed, tuple(worse), bool(agrees))


def mean_square_interval(mean_square: float, rows: int) -> tuple[float, float]:
    """95 % interval of a mean square of `rows` whitened residuals."""
    low, high = float(scipy.stats.chi2.ppf(0.975, rows)), float(scipy.stats.chi2.ppf(0.025, rows))
    return mean_square * rows / low, mean_square * rows / high
