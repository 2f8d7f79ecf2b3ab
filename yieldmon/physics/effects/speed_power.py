"""A change with speed whose curvature is free."""

from __future__ import annotations

import numpy as np

from yieldmon.physics.numerics import AnyArray, exp, real

_LEAST_POWER = 1e-3


def log_growth(ratio: AnyArray, power: AnyArray) -> AnyArray:
    """(ratio^p - 1) / p, log(ratio) in the limit of p = 0: slope 1 at a ratio of 1, bent upwards by a large p.

    ratio: of speed to the nominal one, above 0. power: p.
    """
    log = np.log(ratio)
    # Beside p = 0 the quotient cancels, and its series is right to 1e-9.
    small = np.abs(real(power)) < _LEAST_POWER
    p = np.where(small, 1.0, power)
    series = log * (1.0 + 0.5 * power * log * (1.0 + power * log / 3.0))
    out: AnyArray = np.where(small, series, (exp(p * log) - 1.0) / p)
    return out
