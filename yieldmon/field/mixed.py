"""Rows of two combines under one name: places that leap to and fro faster than a machine drives."""

from __future__ import annotations

from dataclasses import replace
from math import hypot, inf

import numpy as np

from .plane import Sites
from .table import Array, HarvestTable

_FASTEST_M_S, _BESIDE_M = 5.0, 5.0
"""Of a combine at work, and metres beside it, within which a row goes on from the one before."""
_LONGEST_GAP_S, _LONGEST_GAP = 3.0, 4.0
"""Between two rows of a track, s and usual intervals: the longer of them."""
_LEAST_TRACK = 4
"""Rows that go on one after another, from which they are a machine's way and no wrong places."""
_LEAST_TURNS, _LEAST_SHARE = 20, 0.05
"""Changes from one track to the other, and share of the rows on the lesser one, from which two machines made them."""


def with_note(table: HarvestTable) -> tuple[HarvestTable, bool]:
    """The table of one source, which says so where rows of two machines are mixed in it; and whether they are."""
    turns = sum(mixed_loads(table).values())
    if not turns or len(table.sources) != 1:
        return table, turns > 0
    note = (
        f"rows of two machines without names are mixed: places leap to and fro {turns} times; delay, passes and, where rows "
        "have no interval of their own, mass are wrong; expected a file for each machine, or a column with its name"
    )
    return replace(table, sources=(replace(table.sources[0], notes=(*table.sources[0].notes, note)),)), True


def mixed_loads(table: HarvestTable) -> dict[int, int]:
    """Loads in which two machines took turns under one name.

    Parameters
    ----------
    table : HarvestTable

    Returns
    -------
    dict of int to int
        Code of the load -> how often its rows leap from one machine's track to the other's and on along it.
    """
    time, load = table["time_s"], table.labels["load"].codes
    placed = np.isfinite(table["longitude_deg"]) & np.isfinite(table["latitude_deg"]) & np.isfinite(time)
    if placed.sum() < _LEAST_TURNS:
        return {}
    plane = Sites.about(table["longitude_deg"], table["latitude_deg"])
    x, y = plane.to_m(table["longitude_deg"], table["latitude_deg"])
    stream = table.source_of_row.astype(np.intp) * len(table.labels["machine"].names) + table.labels["machine"].codes
    group = stream * (int(load.max(initial=0)) + 1) + load
    order = np.lexsort((np.arange(len(time)), time, group))
    order = order[placed[order]]
    ends = np.flatnonzero(np.diff(group[order])) + 1
    found: dict[int, int] = {}
    for rows in np.split(order, ends):
        turns = _turns(time[rows], x[rows], y[rows])
        if turns:
            found[int(load[rows[0]])] = found.get(int(load[rows[0]]), 0) + turns
    return found


def _turns(time_s: Array, x_m: Array, y_m: Array) -> int:
    """How often these rows, by time, change between two tracks; 0 where one track explains them."""
    gap = np.diff(time_s)
    usual_s = float(np.median(gap[gap > 0])) if np.any(gap > 0) else 0.0
    longest_s = max(_LONGEST_GAP_S, _LONGEST_GAP * usual_s)
    leaps = (np.hypot(np.diff(x_m), np.diff(y_m)) > _FASTEST_M_S * gap + _BESIDE_M) & (gap <= longest_s)
    if leaps.sum() < _LEAST_TURNS:
        return 0
    return _between_tracks(time_s.tolist(), x_m.tolist(), y_m.tolist(), longest_s)


def _between_tracks(time_s: list[float], x_m: list[float], y_m: list[float], longest_s: float) -> int:
    """A row goes on along the track whose last place it can have come from, the nearer one of two; else it begins a track in
    place of the older one."""
    last = [(time_s[0], x_m[0], y_m[0]), (-inf, 0.0, 0.0)]
    whole, run = [1, 0], [1, 0]
    turns = current = 0
    for t, east, north in zip(time_s[1:], x_m[1:], y_m[1:], strict=True):
        near: list[tuple[float, int]] = []
        for which, (then, east_before, north_before) in enumerate(last):
            away = hypot(east - east_before, north - north_before)
            if t - then <= longest_s and away <= _FASTEST_M_S * (t - then) + _BESIDE_M:
                near.append((away, which))
        if near:
            which = min(near)[1]
            turns += which != current and min(run) >= _LEAST_TRACK
            run[which] += 1
            whole[which] += run[which] >= _LEAST_TRACK
        else:
            which = 0 if last[0][0] <= last[1][0] else 1
            run[which] = 1
        current, last[which] = which, (t, east, north)
    return turns if turns >= _LEAST_TURNS and min(whole) >= _LEAST_SHARE * len(time_s) else 0
