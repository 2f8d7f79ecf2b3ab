"""A weighed load of one machine that none of its others bears out, before anything is fitted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.gaussian import SD_PER_MAD
from yieldmon.physics.numerics import Array

LEAST_LOADS = 3
_LEAST_OFF, _TIMES_SCATTER = 0.2, 6.0
"""ln, and robust standard deviations of the others, by which a load is off."""


def unlike_the_others(log_errors: Array) -> NDArray[np.bool_]:
    """Which loads are off what the machine's other loads have in common, by over a fifth and far more than these scatter.

    Parameters
    ----------
    log_errors : ndarray
        (n,) ln of measured over weighed mass of each load; nan where not known.

    Returns
    -------
    ndarray of bool
        (n,). None of fewer than three loads: of two that differ either may be right.

    Examples
    --------
    >>> unlike_the_others(np.log([1.01, 0.1, 0.99, 1.0])).tolist()
    [False, True, False, False]
    """
    found = np.zeros(len(log_errors), bool)
    known = np.flatnonzero(np.isfinite(log_errors))
    if len(known) < LEAST_LOADS:
        return found
    for place in known:
        others = log_errors[known[known != place]]
        middle = float(np.median(others))
        scatter = SD_PER_MAD * float(np.median(np.abs(others - middle)))
        found[place] = abs(log_errors[place] - middle) > max(_LEAST_OFF, _TIMES_SCATTER * scatter)
    return found
