"""Local times at the end of summer time: the hour that comes twice, in which one machine would be at two places at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .mixed import BESIDE_M, FASTEST_M_S, machines_apart
from .table import Array, Label

_HOUR_S = 3600.0
_LONGEST_GAP_S = 60.0
"""Between the last row before the clock is set back and the first one after it."""


def counted_on(time_s: Array, x_m: Array, y_m: Array, machine: Label) -> tuple[Array, str]:
    """Times that go on where a machine's clock was set back by an hour while it drove on.

    Parameters
    ----------
    time_s, x_m, y_m : array, shape (n,)
        Of the rows, in the order of the file; NaN where not known.
    machine : Label
        Name of each row's machine, "" where it has none.

    Returns
    -------
    time_s : array, shape (n,)
        With an hour added to the rows after such a change.
    note : str
        Empty where there is none.
    """
    out, changed = time_s.copy(), False
    for code in np.unique(machine.codes).tolist():
        rows = np.flatnonzero(machine.codes == code)
        parts = machines_apart(time_s[rows], x_m[rows], y_m[rows])
        # Taken for two machines, of which the second is the same one after the change.
        if parts is not None and parts.max() == 1 and _goes_on(time_s[rows], x_m[rows], y_m[rows], parts):
            out[rows[parts == 1]] += _HOUR_S
            changed = True
    note = "the hour at the end of summer time comes twice: times are local; those after it count on from those before it"
    return (out, note) if changed else (time_s, "")


def _goes_on(time_s: Array, x_m: Array, y_m: Array, parts: NDArray[np.int32]) -> bool:
    """Whether the second part begins where the first ends, at a whole hour, and an hour earlier by the clock."""
    placed = np.isfinite(time_s) & np.isfinite(x_m) & np.isfinite(y_m)
    before, after = (np.flatnonzero(placed & (parts == part)) for part in (0, 1))
    last, first = before[np.argmax(time_s[before])], after[np.argmin(time_s[after])]
    gap_s = float(time_s[first] + _HOUR_S - time_s[last])
    at_whole_hour = float(time_s[first]) % _HOUR_S <= gap_s
    distance_m = float(np.hypot(x_m[first] - x_m[last], y_m[first] - y_m[last]))
    return 0.0 < gap_s <= _LONGEST_GAP_S and at_whole_hour and distance_m <= FASTEST_M_S * gap_s + BESIDE_M
