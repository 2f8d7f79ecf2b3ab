"""Times as whole seconds, for formats that know no others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_TOGETHER = 0.5
"""Length of the mean of the fractions, as arrows on a circle, from which they are one clock's."""


def whole_seconds(time_s: NDArray[np.float64]) -> NDArray[Any]:
    """One clock's times to whole seconds. Where they lie about one fraction of a second that is taken off before they are
    rounded, so that rows a second apart stay a second apart: halves would be rounded to one number by twos.

    Parameters
    ----------
    time_s : array, shape (n,)
        Finite.

    Returns
    -------
    array of int, shape (n,)
        Within a second of `time_s`; in the same order.

    Examples
    --------
    >>> whole_seconds(np.array([0.5, 1.5, 2.5])).tolist(), whole_seconds(np.array([7.98, 9.01])).tolist()
    ([0, 1, 2], [8, 9])
    """
    if not len(time_s):
        return np.zeros(0, np.int64)
    arrow = np.mean(np.exp(2j * np.pi * np.mod(time_s, 1.0)))
    off_s = np.angle(arrow) / (2 * np.pi) if abs(arrow) > _TOGETHER else 0.0
    # Halves of fractions that are only nearly one go one way.
    return np.asarray(np.floor(time_s - np.round(off_s, 3) + 0.5), np.int64)
