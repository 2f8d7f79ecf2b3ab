"""How standard deviations go with the level of what they belong to."""

from __future__ import annotations

import numpy as np

from yieldmon.physics.numerics import Array

_LEAST_CONSTANT = 0.01
"""Of the root mean square of all standard deviations: no reading near zero is taken as exact."""


def scatter_law(level: Array, sd: Array) -> tuple[float, float]:
    """Constant and proportional part of the sd of readings at `level`, both of shape (n,): sd^2 = constant^2 + (proportional
    level)^2 by least squares in the variances; the proportional part is 0 where the variances do not rise."""
    square, variance = level**2, sd**2
    slope = max(float(np.polyfit(square, variance, 1)[0]) if np.ptp(np.abs(level)) > 0.0 else 0.0, 0.0)
    least = _LEAST_CONSTANT**2 * float(np.mean(variance))
    constant = max(float(np.mean(variance - slope * square)), least)
    return float(np.sqrt(constant)), float(np.sqrt(slope))
