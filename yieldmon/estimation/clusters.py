"""Values that count as one: plate angles, loads, speeds that were meant to be the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array


def cluster(values: Array, width: float) -> NDArray[np.int64]:
    """Number of the cluster of each value, in ascending order.

    Parameters
    ----------
    values
        (n,), finite.
    width
        Largest distance between the first and last value of a cluster.
    """
    order = np.argsort(values, kind="stable")
    ascending = values[order]
    steps = np.zeros(len(values), dtype=np.int64)
    first = 0
    while first < len(values):
        last = int(np.searchsorted(ascending, ascending[first] + width, side="right"))
        steps[max(last, first + 1) :] += 1
        first = max(last, first + 1)
    out = np.empty(len(values), dtype=np.int64)
    out[order] = steps
    return out
