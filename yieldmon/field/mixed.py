"""Rows of several combines under one name: places that leap to and fro faster than a machine drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, inf

import numpy as np
from numpy.typing import NDArray

from .groups import by_time
from .plane import places_m
from .table import Array, HarvestTable, Label

FASTEST_M_S, BESIDE_M = 5.0, 5.0
"""Of a combine at work, and metres beside it, within which a row goes on from the one before."""
_LONGEST_GAP_S, _LONGEST_GAP = 12.0, 4.0
"""Between two rows of a track, s and usual intervals: the longer of them."""
_LEAST_ROWS = 4
"""Rows that go on one after another, from which they are a machine's path and not wrong places."""
_LEAST_TURNS, _LEAST_SHARE = 20, 0.05
"""Changes from one machine to another, and a machine's share of the rows, from which several made them."""
_LACKS = 1.5
"""Times its usual step that a machine's step is, in the median, where another's rows are in it: the rows were its own."""
_MOST_BLOCKS = 0.005
"""Share of rows before which time runs backwards, up to which a file has its machines one after another."""


@dataclass
class _Stretch:
    """Rows that go on one after another along a path."""

    rows: list[int]
    time_s: float
    x_m: float
    y_m: float


def machines_apart(time_s: Array, x_m: Array, y_m: Array) -> NDArray[np.int32] | None:
    """Which of several machines made each row, by their places alone.

    Parameters
    ----------
    time_s, x_m, y_m : array, shape (n,)
        Of rows that bear one machine's name, in the order of the file; NaN where not known.

    Returns
    -------
    array of int32, shape (n,), or None
        Number of the machine from 0; a row without time or place has that of the row before it. None where one machine explains
        the rows.
    """
    placed = np.flatnonzero(np.isfinite(time_s) & np.isfinite(x_m) & np.isfinite(y_m))
    order = placed[np.argsort(time_s[placed], kind="stable")]
    found, turns = _followed(time_s[order], x_m[order], y_m[order])
    if not turns:
        return None
    of_row = np.full(len(time_s), -1, np.int32)
    by_file = _by_order_of_file(time_s[placed], x_m[placed], y_m[placed])
    if by_file is not None:
        of_row[placed] = by_file
        return _filled(of_row)
    of_row[order] = found
    # Wrong places belong to the machine that was there last; rows without a place to that of the row before them in the file.
    of_row[order] = _filled(of_row[order])
    return _filled(of_row)


def _by_order_of_file(time_s: Array, x_m: Array, y_m: Array) -> NDArray[np.int32] | None:
    """Machine of each row where the file has the rows of one after those of another: a block ends where time runs backwards.

    None where blocks are many, or rows are mixed within them.
    """
    ends = np.flatnonzero(np.diff(time_s) < 0) + 1
    if not 0 < len(ends) <= _MOST_BLOCKS * len(time_s):
        return None
    blocks = [
        _Stretch(rows.tolist(), float(time_s[rows[-1]]), float(x_m[rows[-1]]), float(y_m[rows[-1]]))
        for rows in np.split(np.arange(len(time_s)), ends)
    ]
    codes = np.empty(len(time_s), np.int32)
    for number, rows in enumerate(_machines(blocks, time_s, x_m, y_m)):
        own = np.array(rows)
        codes[own] = number
        if _followed(time_s[own], x_m[own], y_m[own])[1]:
            return None
    return codes


def _filled(codes: NDArray[np.int32]) -> NDArray[np.int32]:
    """Codes with -1 as the one before; the first ones as the first that is known."""
    known = np.maximum.accumulate(np.where(codes >= 0, np.arange(len(codes)), -1))
    first = int(np.argmax(codes >= 0))
    filled: NDArray[np.int32] = codes[np.where(known >= 0, known, first)]
    return filled


def apart(table: HarvestTable) -> HarvestTable:
    """The table of one source with a machine's name for each of several whose rows are mixed under one name, and a note on it."""
    if len(table.sources) != 1 or not len(table) or np.nan_to_num(table["section"]).any():
        return table
    x, y = places_m(table["longitude_deg"], table["latitude_deg"])
    label, note = machine_names(table["time_s"], x, y, table.labels["machine"])
    if not note:
        return table
    return replace(table, labels={**table.labels, "machine": label}).noting(notes=(note,))


def machine_names(time_s: Array, x_m: Array, y_m: Array, machine: Label) -> tuple[Label, str]:
    """Names of the machines that made rows, where several have one name a name for each.

    Parameters
    ----------
    time_s, x_m, y_m : array, shape (n,)
        Of the rows, in the order of the file; NaN where not known.
    machine : Label
        Name of each row's machine, "" where it has none.

    Returns
    -------
    names : Label
    note : str
        What was taken apart; empty where every name is one machine's.
    """
    names: list[str] = []
    codes = np.zeros(len(time_s), np.int32)
    said: list[str] = []
    for code in np.unique(machine.codes).tolist():
        rows = np.flatnonzero(machine.codes == code)
        name, parts = machine.names[code], machines_apart(time_s[rows], x_m[rows], y_m[rows])
        codes[rows] = len(names) + (0 if parts is None else parts)
        if parts is None:
            names.append(name)
            continue
        made = [f"{name} {number}".strip() for number in range(1, int(parts.max()) + 2)]
        names += made
        said += [f"{one} ({number} rows)" for one, number in zip(made, np.bincount(parts).tolist(), strict=True)]
    if not said:
        return machine, ""
    note = f"rows of several machines are mixed under one name: taken apart by their places, as machines {', '.join(said)}"
    return Label(codes, tuple(names)), note


def with_note(table: HarvestTable) -> tuple[HarvestTable, bool]:
    """The table of one source, which says so where rows of two machines are mixed in it; and whether they are."""
    turns = sum(mixed_loads(table).values())
    if not turns or len(table.sources) != 1:
        return table, turns > 0
    note = (
        f"rows of two machines without names are mixed: places jump back and forth {turns} times; delay, passes and, where rows "
        "have no interval of their own, mass are wrong; expected a file for each machine, or a column with its name"
    )
    return table.noting(notes=(note,)), True


def mixed_loads(table: HarvestTable) -> dict[int, int]:
    """Loads in which several machines took turns under one name.

    Parameters
    ----------
    table : HarvestTable

    Returns
    -------
    dict of int to int
        Code of the load -> how often its rows leap from one machine's track to another's and on along it.
    """
    time, load = table["time_s"], table.labels["load"].codes
    placed = np.isfinite(table["longitude_deg"]) & np.isfinite(table["latitude_deg"]) & np.isfinite(time)
    if placed.sum() < _LEAST_TURNS:
        return {}
    x, y = places_m(table["longitude_deg"], table["latitude_deg"])
    group = table.stream * (int(load.max(initial=0)) + 1) + load
    order = by_time(time, group)
    order = order[placed[order]]
    ends = np.flatnonzero(np.diff(group[order])) + 1
    found: dict[int, int] = {}
    for rows in np.split(order, ends):
        _, turns = _followed(time[rows], x[rows], y[rows])
        if turns:
            found[int(load[rows[0]])] = found.get(int(load[rows[0]]), 0) + turns
    return found


def _followed(time_s: Array, x_m: Array, y_m: Array) -> tuple[NDArray[np.int32], int]:
    """Machine of each row, by time, -1 for wrong places; and how often the rows change between machines, 0 for one machine."""
    of_row = np.full(len(time_s), -1, np.int32)
    gap = np.diff(time_s)
    usual_s = float(np.median(gap[gap > 0])) if np.any(gap > 0) else 0.0
    longest_s = max(_LONGEST_GAP_S, _LONGEST_GAP * usual_s)
    # A gap of a damaged time may be any number.
    reach_m = FASTEST_M_S * np.minimum(gap, longest_s) + BESIDE_M
    leaps = (np.hypot(np.diff(x_m), np.diff(y_m)) > reach_m) & (gap <= longest_s)
    if leaps.sum() < _LEAST_TURNS:
        return of_row, 0
    stretches = _stretches(time_s.tolist(), x_m.tolist(), y_m.tolist(), longest_s)
    machines = _machines([one for one in stretches if len(one.rows) >= _LEAST_ROWS], time_s, x_m, y_m)
    kept = [rows for rows in machines if len(rows) >= _LEAST_SHARE * len(time_s)]
    for number, rows in enumerate(kept):
        of_row[rows] = number
    placed = np.flatnonzero(of_row >= 0)
    turned = placed[1:][np.diff(of_row[placed]) != 0]
    if len(kept) < 2 or len(turned) < _LEAST_TURNS or _takes_turns(kept, turned, of_row, time_s, longest_s):
        return of_row, 0
    return of_row, len(turned)


def _takes_turns(
    machines: Sequence[list[int]], turned: NDArray[np.intp], of_row: NDArray[np.int32], time_s: Array, longest_s: float
) -> bool:
    """Whether each machine lacks rows while another has some: then they are one, whose receiver leaps to and fro.

    turned: rows before which the machine changes.
    """
    times: list[float] = []
    for number, rows in enumerate(machines):
        own = np.unique(time_s[rows])
        steps = np.diff(own)
        if not steps.size:
            continue
        at = np.searchsorted(own, time_s[turned[of_row[turned] == number]])
        since = steps[at[at > 0] - 1]
        times += (since[since <= longest_s] / np.median(steps)).tolist()
    return bool(times) and float(np.median(times)) >= _LACKS


def _stretches(time_s: list[float], x_m: list[float], y_m: list[float], longest_s: float) -> list[_Stretch]:
    """A row goes on along the stretch whose last place it can have come from, the nearest one; else it begins one."""
    found: list[_Stretch] = []
    alive: list[_Stretch] = []
    for row, (time, east, north) in enumerate(zip(time_s, x_m, y_m, strict=True)):
        alive = [one for one in alive if time - one.time_s <= longest_s]
        nearest, least_m = None, inf
        for one in alive:
            away_m = hypot(east - one.x_m, north - one.y_m)
            if away_m < least_m and away_m <= FASTEST_M_S * (time - one.time_s) + BESIDE_M:
                nearest, least_m = one, away_m
        if nearest is None:
            nearest = _Stretch([], time, east, north)
            found.append(nearest)
            alive.append(nearest)
        nearest.rows.append(row)
        nearest.time_s, nearest.x_m, nearest.y_m = time, east, north
    return found


def _machines(stretches: Sequence[_Stretch], time_s: Array, x_m: Array, y_m: Array) -> list[list[int]]:
    """Rows of as few machines as made these stretches, none two at a time: each by the next one that is free."""
    machines: list[list[int]] = []
    for stretch in sorted(stretches, key=lambda one: (time_s[one.rows[0]], one.rows[0])):
        first = stretch.rows[0]
        free = [rows for rows in machines if time_s[rows[-1]] <= time_s[first]]
        if free:
            last = min(free, key=lambda rows: hypot(x_m[first] - x_m[rows[-1]], y_m[first] - y_m[rows[-1]]))
            last += stretch.rows
        else:
            machines.append(list(stretch.rows))
    return machines
