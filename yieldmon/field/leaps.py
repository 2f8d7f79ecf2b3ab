"""Places that leap away and back: errors of a receiver, which the distance between the places around them does not contain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .table import Array

_FASTEST_M_S, _BESIDE_M = 15.0, 5.0
"""Of a combine on a road, and metres beside it, beyond which a place that is left again at once is wrong."""
_MOST_ASTRAY, _LONGEST_BRIDGE = 3, 6
"""Consecutive rows that may be astray, and the rows from one known place to the next that are taken to be evenly spaced."""


def bridged(x_m: Array, y_m: Array, time_s: Array, stream: NDArray[np.intp]) -> tuple[Array, Array]:
    """Places with those that are not known, or that are left again at once faster than a machine drives, between the ones beside
    them.

    Parameters
    ----------
    x_m, y_m : array, shape (n,)
        On a plane, in order of stream and time; NaN where not known.
    time_s : array, shape (n,)
    stream : array of int, shape (n,)
        Machine and section.

    Examples
    --------
    >>> seconds = np.arange(6.0)
    >>> bridged(np.array([0.0, 2.0, 700.0, 6.0, np.nan, 10.0]), np.zeros(6), seconds, np.zeros(6, int))[0].tolist()
    [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    """
    x, y = x_m.copy(), y_m.copy()
    for rows in np.split(np.arange(len(x)), np.flatnonzero(np.diff(stream)) + 1):
        own_x, own_y, own_s = x[rows], y[rows], time_s[rows]
        astray = _astray(own_x, own_y, own_s)
        known = np.flatnonzero(np.isfinite(own_x) & np.isfinite(own_s) & ~astray)
        if not known.size or known.size == len(rows):
            continue
        missing = np.setdiff1d(np.flatnonzero(np.isfinite(own_s)), known)
        right = np.searchsorted(known, missing)
        inside = (right > 0) & (right < known.size)
        near = known[np.minimum(right, known.size - 1)] - known[np.maximum(right - 1, 0)] <= _LONGEST_BRIDGE
        at = missing[inside & near]
        own_x[missing], own_y[missing] = np.nan, np.nan
        own_x[at], own_y[at] = (np.interp(own_s[at], own_s[known], places[known]) for places in (own_x, own_y))
        x[rows], y[rows] = own_x, own_y
    return x, y


def _astray(x: Array, y: Array, time_s: Array) -> NDArray[np.bool_]:
    """Up to three rows one after another to which and from which no machine drives, while the rows around them go on."""
    out = np.zeros(len(x), bool)

    def leaps(one: NDArray[np.intp], other: NDArray[np.intp]) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore", over="ignore"):
            leap = np.hypot(x[other] - x[one], y[other] - y[one]) > _FASTEST_M_S * np.abs(time_s[other] - time_s[one]) + _BESIDE_M
        return np.asarray(leap)

    for long in range(1, _MOST_ASTRAY + 1):
        first = np.arange(1, len(x) - long)
        known = np.isfinite(x[first - 1]) & np.isfinite(x[first + long])
        found = first[known & leaps(first - 1, first) & leaps(first + long - 1, first + long) & ~leaps(first - 1, first + long)]
        for further in range(long):
            out[found + further] = True
    return out
