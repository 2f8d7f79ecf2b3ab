"""What the points about a point say of its value: an error stands alone, a spot of the field does not."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from yieldmon.estimation.gaussian import SD_PER_MAD

from .table import Array, Flags
from .tracks import Tracks

_LOCAL_NEIGHBOURS = 24
_LOCAL_SD = 4.0
_LEAST_SPREAD = 0.02
"""Relative robust standard deviation that a second's yield has at least: even ground would make errors of rounding outliers."""
_NEAR_ROWS, _NEAR_WIDTHS, _LEAST_NEAR, _SHARED = 64, 1.6, 3, 0.3
"""Rows about a point that are asked for those of other passes, how many widths off, how many of these can say what is there, and
the share of them that has to say the same: at a spot's edge the passes on one side do."""
_CHUNK = 100_000


def local_outliers(x_m: Array, y_m: Array, amount: Array, among: Flags) -> Flags:
    """Rows whose value is over `_LOCAL_SD` robust standard deviations off the median of their neighbours."""
    out = np.zeros(len(x_m), bool)
    rows = np.flatnonzero(among)
    if len(rows) < 4 * _LOCAL_NEIGHBOURS:
        return out
    places = np.column_stack((x_m[rows], y_m[rows]))
    tree = cKDTree(places)
    values = amount[rows].astype(np.float32)
    middle = np.empty(len(rows))
    for first in range(0, len(rows), _CHUNK):
        near = np.asarray(tree.query(places[first : first + _CHUNK], k=_LOCAL_NEIGHBOURS + 1)[1])
        half = _LOCAL_NEIGHBOURS // 2
        middle[first : first + _CHUNK] = np.partition(values[near[:, 1:]], half, axis=1)[:, half]
    off = amount[rows] - middle
    spread = SD_PER_MAD * float(np.median(np.abs(off - np.median(off))))
    out[rows] = np.abs(off) > _LOCAL_SD * np.maximum(spread, _LEAST_SPREAD * np.abs(middle))
    return out


def shared(steps: Tracks, values: Array, doubtful: Flags) -> Flags:
    """Doubtful rows whose value neighbouring passes show too: a spot without a crop, or a rich one, is no error.

    Parameters
    ----------
    steps : Tracks
        Of all rows.
    values : array, shape (n,)
        Flow by width or yield of each row, NaN where there is none.
    doubtful : array of bool, shape (n,)
        Rows in question. Theirs is shared where _SHARED of the nearest rows of other passes are nearer to it than half of the
        difference from the field's median.
    """
    number = steps.pass_number[steps.step_of_row]
    known = np.flatnonzero(np.isfinite(values) & np.isfinite(steps.row_x_m) & (number >= 0))
    out = np.zeros(len(values), bool)
    asked = known[doubtful[known]]
    if not len(asked) or len(known) < _NEAR_ROWS:
        return out
    places = np.column_stack((steps.row_x_m, steps.row_y_m))
    tree = cKDTree(places[known])
    width = steps.width_m[steps.step_of_row]
    usual = float(np.median(values[known]))
    for first in range(0, len(asked), _CHUNK // _NEAR_ROWS):
        rows = asked[first : first + _CHUNK // _NEAR_ROWS]
        distance, found = tree.query(places[rows], k=_NEAR_ROWS)
        near = known[found]
        other = (number[near] != number[rows][:, None]) & (distance <= _NEAR_WIDTHS * width[rows][:, None])
        alike = np.abs(values[near] - values[rows][:, None]) < 0.5 * np.abs(values[rows] - usual)[:, None]
        number_alike = np.count_nonzero(other & alike, axis=1)
        out[rows] = number_alike >= np.maximum(_LEAST_NEAR, _SHARED * np.count_nonzero(other, axis=1))
    return out
