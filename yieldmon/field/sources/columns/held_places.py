"""Places that stay for some rows because the receiver is slower than the log, or its places are rounded to few digits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.field.groups import by_time
from yieldmon.field.plane import wrapped_deg
from yieldmon.field.table import Array

_LEAST_ROWS, _LEAST_S = 2, 1.5
"""Rows and seconds for which a place stays in the median, from which it is held: rows of one second are taken together later."""
_LONGEST = 3.0
"""Times the median that a place is held; where it stays for longer the machine stands."""
_LEAST_PLACES = 10


def between_fixes(
    longitude_deg: Array, latitude_deg: Array, time_s: Array, machine: NDArray[np.int32]
) -> tuple[Array, Array, tuple[str, ...]]:
    """Longitudes and latitudes with those that are held moved towards the next one, by time; and a note where there are such.

    Parameters
    ----------
    longitude_deg, latitude_deg : array, shape (n,)
        NaN where not known.
    time_s : array, shape (n,)
    machine : array of int, shape (n,)
        That made each row.

    Examples
    --------
    >>> held = np.repeat(np.arange(20.0), 5)
    >>> between_fixes(held, held, np.arange(100.0), np.zeros(100, np.int32))[0][[0, 1, 5, 96]].round(6).tolist()
    [0.0, 0.2, 1.0, 19.2]
    """
    order = by_time(time_s, machine)
    order = order[np.isfinite(longitude_deg[order]) & np.isfinite(latitude_deg[order]) & np.isfinite(time_s[order])]
    east, north, seconds, whose = longitude_deg[order], latitude_deg[order], time_s[order], machine[order]
    begins = np.r_[True, (np.diff(east) != 0) | (np.diff(north) != 0) | (np.diff(whose) != 0)][: len(order)]
    first = np.flatnonzero(begins)
    rows, held_s = np.diff(first), np.diff(seconds[first])
    on = np.diff(whose[first]) == 0
    if on.sum() < _LEAST_PLACES or np.median(rows[on]) < _LEAST_ROWS or np.median(held_s[on]) < _LEAST_S:
        return longitude_deg, latitude_deg, ()
    usual_rows, usual_s = float(np.median(rows[on])), float(np.median(held_s[on]))
    drives = np.r_[on & (rows <= _LONGEST * usual_rows) & (held_s <= _LONGEST * usual_s) & (held_s > 0), False]
    # Before a pause the machine goes on as it came.
    pauses = ~drives & np.r_[False, drives[:-1]] & (np.diff(first, append=len(order)) <= usual_rows)
    from_place = np.arange(len(first)) - pauses
    of_row = np.cumsum(begins) - 1
    between = np.flatnonzero(~begins & (drives | pauses)[of_row])
    place = of_row[between]
    former, latter = first[from_place[place]], first[from_place[place] + 1]
    share = (seconds[between] - seconds[first[place]]) / (seconds[latter] - seconds[former])
    out_east, out_north = longitude_deg.copy(), latitude_deg.copy()
    step_east = wrapped_deg(east[latter] - east[former])
    out_east[order[between]] = wrapped_deg(east[first[place]] + share * step_east)
    out_north[order[between]] = north[first[place]] + share * (north[latter] - north[former])
    note = f"places stay for {usual_s:.3g} s, longer than the rows last: {len(between)} rows are interpolated between them"
    return out_east, out_north, (note,)
