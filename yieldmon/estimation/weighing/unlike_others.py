"""Gross outliers before any fit: loads unlike the machine's other loads, and machines unlike the other machines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.gaussian import SD_PER_MAD
from yieldmon.physics.numerics import Array

LEAST_LOADS = 3
LEAST_MACHINES = 5
"""Least number of machines from which their scatter can be estimated."""
_LEAST_OFF, _TIMES_SCATTER = 0.2, 6.0
"""Deviation of ln mass, and in robust standard deviations of the others, beyond which a load is an outlier."""
LEAST_OFF_OF_MACHINES = 0.4
"""The former for a machine: two standard deviations of the gain of a machine that was never calibrated."""

_DENSITIES_OFF = 1.0
"""Deviation of a machine's ln density beyond which it is an outlier. With correct tickets it is up to 0.85 (144 simulated fleets,
two loads or more of each machine)."""


def unlike_the_others(log_errors: Array) -> NDArray[np.bool_]:
    """Which loads deviate from the median of the machine's other loads by more than a fifth and far more than these scatter.

    Parameters
    ----------
    log_errors : ndarray
        (n,) ln of measured over weighed mass of each load; nan if not known.

    Returns
    -------
    ndarray of bool
        (n,). All False for fewer than three loads: of two that differ either may be right.

    Examples
    --------
    >>> unlike_the_others(np.log([1.01, 0.1, 0.99, 1.0])).tolist()
    [False, True, False, False]
    """
    return _off(log_errors, LEAST_LOADS, _LEAST_OFF)


def unlike_the_other_machines(log_errors: Array) -> NDArray[np.bool_]:
    """Which machines deviate from the median of the others, for example because all tickets of one are in pounds.

    Parameters
    ----------
    log_errors : ndarray
        (n,) median of ln(measured / weighed mass) of each machine's loads; nan if not known.

    Returns
    -------
    ndarray of bool
        (n,). All False for fewer than five machines.

    Examples
    --------
    >>> unlike_the_other_machines(np.log([1.01, 0.45, 0.99, 1.0, 1.03])).tolist()
    [False, True, False, False, False]
    """
    return _off(log_errors, LEAST_MACHINES, LEAST_OFF_OF_MACHINES)


def unlike_the_other_densities(log_densities: Array) -> int | None:
    """Which machine's fitted density is impossible for the crop, for example because one of two tickets is wrong.

    Parameters
    ----------
    log_densities : ndarray
        (n,) ln of the density fitted to each machine's loads.

    Returns
    -------
    int or None
        Index of the one farthest from the median of the others, if the factor is over 2.7. It may make others look wrong: test
        these again without it.

    Examples
    --------
    >>> unlike_the_other_densities(np.array([0.1, -1.4, 0.2]))
    1
    """
    off = [abs(one - np.median(np.delete(log_densities, place))) for place, one in enumerate(log_densities)]
    return int(np.argmax(off)) if max(off) > _DENSITIES_OFF else None


def _off(log_errors: Array, least: int, least_off: float) -> NDArray[np.bool_]:
    found = np.zeros(len(log_errors), bool)
    known = np.flatnonzero(np.isfinite(log_errors))
    if len(known) < least:
        return found
    for place in known:
        others = log_errors[known[known != place]]
        middle = float(np.median(others))
        scatter = SD_PER_MAD * float(np.median(np.abs(others - middle)))
        found[place] = abs(log_errors[place] - middle) > max(least_off, _TIMES_SCATTER * scatter)
    return found
