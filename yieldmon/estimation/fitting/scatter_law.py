"""How standard deviations go with the level of what they belong to: from stated ones, or from the scatter of repetitions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.gaussian import SD_PER_MAD
from yieldmon.physics.numerics import Array

OUTLIER_SDS = 5.0
"""Robust standard deviations from which a row is an outlier."""
LEAST_PURE_DOF = 8
"""Degrees of freedom of repeated rows from which they part noise from the model's own error, and determine its law."""
_MOST_OUTLIERS = 0.1
"""Share of the rows."""
_LEAST_CONSTANT = 0.01
"""Of the root mean square of all standard deviations: no reading near zero is taken as exact."""
_LEAST_DISTINCT = 3
_CHI_SQUARE_95 = 3.84
"""95 % quantile of chi-square with one degree of freedom."""
_SAME_STEP = 1e-3
"""Share of a step by which readings in whole steps may miss one."""


def scatter_law(level: Array, sd: Array) -> tuple[float, float]:
    """Constant and proportional part of the sd of readings at `level`, both of shape (n,): sd^2 = constant^2 + (proportional
    level)^2 by least squares in the variances; the proportional part is 0 where the variances do not rise."""
    square, variance = level**2, sd**2
    slope = max(float(np.polyfit(square, variance, 1)[0]) if np.ptp(np.abs(level)) > 0.0 else 0.0, 0.0)
    least = _LEAST_CONSTANT**2 * float(np.mean(variance))
    constant = max(float(np.mean(variance - slope * square)), least)
    return float(np.sqrt(constant)), float(np.sqrt(slope))


def fit_variances(variance: Array, dof: Array, level2: Array, pooled: float) -> tuple[float, float]:
    """(a^2, b^2) of variance = a^2 + b^2 level^2 by gamma likelihood; (pooled, 0) unless the data ask for more (5 %)."""
    floor = 0.02 * pooled

    def deviance(model: Array) -> float:
        return float(np.sum(dof * (np.log(model) + variance / model)))

    best = (pooled, 0.0)
    least = deviance(np.full_like(variance, pooled)) - _CHI_SQUARE_95
    top = float(level2.max())
    if np.ptp(level2) <= 1e-3 * top:
        return best
    for share in np.linspace(0.02, 0.98, 49):
        # `share` of the variance at the top level is proportional; the overall size follows in closed form.
        form = (1.0 - share) + share * level2 / top
        size = float(np.sum(dof * variance / form) / dof.sum())
        value = deviance(np.maximum(size * form, floor))
        if value < least:
            best, least = (max(size * (1.0 - share), floor), size * share / top), value
    return best


def rounding_sd(readings: Array) -> float:
    """Standard deviation of the rounding of readings that all lie whole steps apart, step / sqrt(12); 0 where they do not."""
    distinct = np.unique(readings)
    if distinct.size < _LEAST_DISTINCT:
        return 0.0
    step = float(np.diff(distinct).min())
    steps = (distinct - distinct[0]) / step
    return step / float(np.sqrt(12.0)) if np.all(np.abs(steps - np.round(steps)) < _SAME_STEP) else 0.0


def scattering(readings: Array, group: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Rows (n,) of groups whose readings differ at all, or all rows where no group's do or readings lie whole steps apart.

    Where readings have every digit, repetitions that agree in all of them measured nothing, as where all grain misses the plate,
    and do not show how much others scatter. group (n,): numbers from 0 without a gap.
    """
    lowest, highest = np.full(int(group.max()) + 1, np.inf), np.full(int(group.max()) + 1, -np.inf)
    np.minimum.at(lowest, group, readings)
    np.maximum.at(highest, group, readings)
    differ = (highest > lowest)[group]
    return differ if differ.any() and rounding_sd(readings) == 0.0 else np.ones(readings.size, dtype=bool)


def medians(values: Array, group: NDArray[np.int64]) -> Array:
    """Median of the values (n,) in each group; group (n,): numbers from 0 without a gap."""
    return np.array([np.median(values[group == number]) for number in range(int(group.max()) + 1)])


def either_form(level: Array) -> Array:
    """Standard deviations at a level (n,) but for a common factor, nearly right for constant and for proportional noise alike: by
    them outliers are found before the law is known."""
    return np.asarray(0.15 * float(np.max(np.abs(level))) + np.abs(level))


def usual_deviation(relative: Array) -> float:
    """Robust standard deviation from absolute deviations, all of them >= 0.

    Of readings in steps coarser than their noise most repetitions agree in every digit; there the usual
    difference of those that do not, a step, stands for it: where a tenth of the rows differ these are no outliers.
    """
    usual = SD_PER_MAD * float(np.median(relative))
    differ = relative[relative > 0.0]
    if usual == 0.0 and differ.size > _MOST_OUTLIERS * relative.size:
        return float(np.median(differ))
    return usual
