"""Sums and counts over consecutive segments of an array, one segment a window.

Sums run over one segment at a time, without padding, so that a window's result does not depend on how many windows are computed
together.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

Counts = NDArray[np.intp]


def bounds_at(times: Array, edges: Array) -> Counts:
    """First entry of each window between edges and the end of the last, (w + 1,); a time that lies back belongs to the window it
    came in."""
    inner = np.searchsorted(np.maximum.accumulate(times), edges[1:-1], side="left") if edges.size > 2 else ()
    return np.array([0, *inner, times.size], dtype=np.intp)


def steps(before: float, values: Array) -> Array:
    """Each value less the one before it, the first less `before`; numpy.diff with `prepend` takes several times as long."""
    found = np.empty(values.shape)
    if values.size:
        found[0] = values[0] - before
        np.subtract(values[1:], values[:-1], out=found[1:])
    return found


def reduce(operation: np.ufunc, values: NDArray[Any], bounds: Counts, empty: float) -> NDArray[Any]:
    """The operation over each segment of values between bounds (w + 1,), `empty` for a segment without values."""
    some = bounds[1:] > bounds[:-1]
    if some.all():
        found: NDArray[Any] = operation.reduceat(values, bounds[:-1])
        return found
    found = np.full(some.size, empty, dtype=values.dtype)
    if some.any():
        found[some] = operation.reduceat(values, bounds[:-1][some])
    return found


def count(marked: NDArray[np.bool_], bounds: Counts) -> Counts:
    """How many are marked in each segment between bounds (w + 1,)."""
    places = np.flatnonzero(marked)
    found: Counts = np.diff(np.searchsorted(places, bounds))
    return found


def sum_between(values: Array, starts: Counts, stops: Counts) -> Array:
    """Sums of values[start:stop], each of at least one value; values has one entry to spare at its end."""
    pairs = np.column_stack((starts, stops)).ravel()
    sums: Array = np.add.reduceat(values, pairs)[::2]
    return sums


def sum_rows(table: Array) -> Array:
    """Sums of the rows of a table with few columns, from left to right."""
    total = table[:, 0]
    for column in range(1, table.shape[1]):
        total = total + table[:, column]
    return total
