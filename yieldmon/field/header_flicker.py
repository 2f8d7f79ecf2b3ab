"""Moments with the header up within a pass, as a loose switch makes them: each would be the end of one pass and the start of
another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.frames import FLICKER_S
from yieldmon.units import counted

from .table import Flags, HarvestTable
from .tracks import MIN_SPEED_M_S, Tracks

_STRAIGHT_DEG = 30.0


def flickers(table: HarvestTable, steps: Tracks) -> Flags:
    """Rows with the header up for at most FLICKER_S between rows with it down, while the machine drives straight on.

    Parameters
    ----------
    table : HarvestTable
    steps : Tracks
        Of the table.

    Returns
    -------
    Flags
        Of each row of the table, (rows,).
    """
    count = len(steps)
    down, lifted = np.zeros(count, bool), np.zeros(count, bool)
    down[steps.step_of_row[table["header_down"] > 0]] = True
    lifted[steps.step_of_row[table["header_down"] == 0]] = True
    up = lifted & ~down
    begin = np.flatnonzero(up & ~np.r_[False, up[:-1]])
    end = np.flatnonzero(up & ~np.r_[up[1:], False])
    inside = (begin > 0) & (end < count - 1)
    begin, end = begin[inside], end[inside]
    before, after = begin - 1, end + 1
    turned = np.cos(steps.heading_rad[after] - steps.heading_rad[before]) < np.cos(np.radians(_STRAIGHT_DEG))
    driven = np.cumsum(np.r_[0, np.nan_to_num(steps.speed_m_s) > MIN_SPEED_M_S])
    moments = (
        down[before] & down[after]
        & (steps.run[before] == steps.run[after])
        & (steps.time_s[end] - steps.time_s[before] <= FLICKER_S + 0.5 * steps.usual_interval_s)
        & (driven[after] - driven[begin] == after - begin)
        & ~turned
    )  # fmt: skip
    change = np.zeros(count + 1, int)
    np.add.at(change, begin[moments], 1)
    np.add.at(change, after[moments], -1)
    return np.asarray((np.cumsum(change)[:-1] > 0)[steps.step_of_row] & (table["header_down"] == 0))


def bridged_header(table: HarvestTable, rows: Flags) -> HarvestTable:
    """The table with the header down in these rows."""
    header = np.where(rows, 1.0, table["header_down"])
    return replace(table, columns={**table.columns, "header_down": header})


def flicker_note(rows: Flags) -> str:
    """What is said of the rows that are bridged."""
    moments = f"the header is up for at most {FLICKER_S:g} s within passes"
    return f"{moments} ({counted(int(rows.sum()), 'row')}): taken as a switch that flickers, and as harvesting"
