"""Rows of one time that stand side by side: the sections of a header, also where no column numbers them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from yieldmon.field.groups import step_begins
from yieldmon.field.plane import places_m
from yieldmon.field.table import Array

_LEAST_SHARE = 0.5
"""Of the rows, that share their time with others where they are sections."""
_ACROSS = 3.0
"""Least ratio of the spread across the direction of travel to that along it."""
_OF_A_WIDTH = (0.3, 3.0)
"""Of a row's width, that the next one beside it is away."""
_WIDEST_M = 60.0
_FORGOTTEN_S = 10.0
"""After which a section's last place says nothing of the next one."""


def steps_of_sections(time_s: Array, section: Array) -> NDArray[np.intp]:
    """Number of the header's step that each row belongs to, by time: one begins where the time changes or a section comes again.

    Parameters
    ----------
    time_s, section : array, shape (n,)
        Of one machine's rows, in the order of the file.

    Examples
    --------
    >>> steps_of_sections(np.array([5.0, 5.0, 5.0, 5.0, 6.0]), np.array([1.0, 2.0, 1.0, 2.0, 1.0])).tolist()
    [0, 0, 1, 1, 2]
    """
    order = np.argsort(time_s, kind="stable")
    out = np.zeros(len(time_s), np.intp)
    number, before_s = -1, np.nan
    seen: set[float] = set()
    for row, at_s, name in zip(order.tolist(), time_s[order].tolist(), section[order].tolist(), strict=True):
        if at_s != before_s or name in seen:
            number += 1
            seen = set()
        seen.add(name)
        before_s = at_s
        out[row] = number
    return out


def numbered(longitude: Array, latitude: Array, width_m: Array, time_s: Array, machine: NDArray[np.int32]) -> Array | None:
    """Number of the section of each row, from 1; None where rows are no sections.

    Parameters
    ----------
    longitude, latitude, width_m, time_s : array, shape (n,)
    machine : array of int, shape (n,)
        That made each row.
    """
    known = np.flatnonzero(np.isfinite(longitude) & np.isfinite(latitude) & np.isfinite(time_s))
    if not known.size:
        return None
    order = known[np.lexsort((known, time_s[known], machine[known]))]
    begins = np.append(np.flatnonzero(step_begins(time_s[order], machine[order])), len(order))
    sizes = np.diff(begins)
    if sizes[sizes > 1].sum() < _LEAST_SHARE * len(order):
        return None
    x, y = places_m(longitude, latitude)
    groups = [order[begin:end] for begin, end in zip(begins[:-1].tolist(), begins[1:].tolist(), strict=True)]
    if not _are_beside(groups, x, y, width_m):
        return None
    out = np.zeros(len(longitude))
    _follow(groups, x, y, time_s, out)
    return out


def beside(section: Array) -> str:
    """What is said of rows that are taken as sections. section: their numbers."""
    return f"rows of one time stand side by side: they are taken as {int(section.max())} sections of the header"


def _are_beside(groups: list[NDArray[np.intp]], x: Array, y: Array, width_m: Array) -> bool:
    """Whether rows of one time lie across the direction of travel, as far apart as they are wide."""
    along, across, apart = [], [], []
    for before, here in pairwise(groups):
        if len(here) < 2 or len(before) < 2:
            continue
        travel = np.array([x[here].mean() - x[before].mean(), y[here].mean() - y[before].mean()])
        length = float(np.hypot(*travel))
        if not 0.2 < length < _WIDEST_M:
            continue
        east, north = x[here] - x[here].mean(), y[here] - y[here].mean()
        lengthwise, sideways = (east * travel[0] + north * travel[1]) / length, (east * travel[1] - north * travel[0]) / length
        along.append(float(np.ptp(lengthwise)))
        across.append(float(np.ptp(sideways)))
        apart.append(float(np.median(np.diff(np.sort(sideways)))) / max(float(np.nanmedian(width_m[here])), 1e-6))
    if len(along) < 20:
        return False
    low, high = _OF_A_WIDTH
    return bool(
        np.median(across) > _ACROSS * np.median(along) and np.median(across) < _WIDEST_M and low < np.median(apart) < high
    )


def _follow(groups: list[NDArray[np.intp]], x: Array, y: Array, time_s: Array, out: Array) -> None:
    """Numbers sections: each row goes on from the nearest last place of one; after a pause they are numbered anew."""
    last: list[tuple[float, float]] = []
    before_s = -np.inf
    for rows in groups:
        at_s = float(time_s[rows[0]])
        if not last or not 0 <= at_s - before_s <= _FORGOTTEN_S:
            last = []
        away = [
            (float(np.hypot(x[row] - place[0], y[row] - place[1])), row, number)
            for row in rows.tolist()
            for number, place in enumerate(last)
        ]
        free, left = set(range(len(last))), set(rows.tolist())
        for _, row, number in sorted(away):
            if row in left and number in free:
                out[row] = number + 1
                last[number] = (float(x[row]), float(y[row]))
                free.discard(number)
                left.discard(row)
        for row in sorted(left):
            last.append((float(x[row]), float(y[row])))
            out[row] = len(last)
        before_s = at_s
