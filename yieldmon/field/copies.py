"""Rows that two sources hold: a harvest that was exported twice, or a day's file beside that of the week, counts once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from yieldmon.units import counted

from .table import Array, HarvestTable, Skipped

_LEAST_ROWS = 20
"""Rows of the same time and place from which they are the same rows."""
_LEAST_SHARE = 0.1
"""Share of the smaller source at the places of the other, by another clock, from which they are the same rows."""
_PLACE_DEG = 3e-6
"""Decimals of degrees differ between formats: a third of a metre."""
_CLOCK_S = 0.01
_MOST_AT_ONCE = 16
_SAMPLE, _LEAST_OF_SAMPLE = 200, 0.03
"""Rows of the smaller source that are looked up first, and the share of them that must be at places of the other."""
_CLOCKS_S, _NEARLY_ALL = 1.0, 0.8
"""How well two clocks agree on a copy, and the share of rows at the same places that do; a machine that stands has others."""


def without_copies(table: HarvestTable, least_rows: int = _LEAST_ROWS) -> HarvestTable:
    """The table with the rows that a source before theirs holds left out, which the later source then says.

    Parameters
    ----------
    table : HarvestTable
        Of several sources.
    least_rows : int
        Rows of the same time and place from which they are the same rows.

    Returns
    -------
    HarvestTable
        The masses and areas that a later source states are 0 where the one before holds nine tenths of its rows.
    """
    if len(table.sources) < 2:
        return table
    key = _ticks(table["time_s"])
    placed = np.isfinite(table["longitude_deg"]) & np.isfinite(table["latitude_deg"]) & (key >= 0)
    sources, again = list(table.sources), np.zeros(len(table), bool)
    reach, other_clocks = _Reach(table, key, placed), _OtherClocks(table)
    for later in range(1, len(sources)):
        for former in range(later):
            if not reach.meet_in_place(former, later):
                continue
            mine = np.flatnonzero(placed & ~again & (table.source_of_row == later))
            theirs = np.flatnonzero(placed & ~again & (table.source_of_row == former))
            same, clock = mine[:0], ""
            if reach.meet(former, later):
                same = mine[_held(table, key, mine, theirs)]
            if len(same) < least_rows:
                same, off_s = other_clocks.copies(later, mine, former, theirs)
                clock = f" by a clock that is {round(off_s, 1) + 0.0:.12g} s off"
                if len(same) < max(_LEAST_ROWS, _LEAST_SHARE * min(len(mine), len(theirs))):
                    continue
            again[same] = True
            left = Skipped(counted(len(same), "row"), f"also in {sources[former].path}{clock}: the same harvest counts once")
            whole = len(same) >= 0.9 * len(mine)
            sources[later] = replace(
                sources[later],
                skipped=(*sources[later].skipped, left),
                mass_kg=0.0 if whole and sources[later].mass_kg is not None else sources[later].mass_kg,
                area_m2=0.0 if whole and sources[later].area_m2 is not None else sources[later].area_m2,
            )
    if not again.any():
        return table
    return replace(table.take(~again), sources=tuple(sources))


class _Reach:
    """When and where the rows of each source lie."""

    def __init__(self, table: HarvestTable, key: NDArray[np.int64], placed: NDArray[np.bool_]) -> None:
        source = table.source_of_row[placed]
        values = (key[placed], table["longitude_deg"][placed], table["latitude_deg"][placed])
        self._low, self._high = np.full((len(table.sources), 3), np.inf), np.full((len(table.sources), 3), -np.inf)
        for axis, value in enumerate(values):
            np.minimum.at(self._low[:, axis], source, value)
            np.maximum.at(self._high[:, axis], source, value)

    def meet(self, one: int, other: int) -> bool:
        """Whether two sources have a time and a place in common."""
        return bool(self._common(one, other).all())

    def meet_in_place(self, one: int, other: int) -> bool:
        """Whether two sources have a place in common."""
        return bool(self._common(one, other)[1:].all())

    def _common(self, one: int, other: int) -> NDArray[np.bool_]:
        margin = np.array([0.0, _PLACE_DEG, _PLACE_DEG])
        low, high = np.maximum(self._low[one], self._low[other]), np.minimum(self._high[one], self._high[other])
        return np.asarray(low <= high + margin)


def _ticks(time_s: Array) -> NDArray[np.int64]:
    """Times as whole numbers, -1 for those that are not known."""
    known = np.isfinite(time_s)
    first = float(time_s[known].min()) if known.any() else 0.0
    return np.where(known, np.round((np.where(known, time_s, first) - first) / _CLOCK_S), -1).astype(np.int64)


class _OtherClocks:
    """Rows at the places of another source's, by a clock of their own."""

    def __init__(self, table: HarvestTable) -> None:
        self._time_s = table["time_s"]
        # Sections are far from each other.
        self._places = np.column_stack((table["longitude_deg"], table["latitude_deg"], np.nan_to_num(table["section"])))
        self._trees: dict[int, tuple[NDArray[np.intp], cKDTree]] = {}

    def copies(self, later: int, mine: NDArray[np.intp], former: int, theirs: NDArray[np.intp]) -> tuple[NDArray[np.intp], float]:
        """Which of `mine` have the place of one of `theirs`, as much later as nearly all have, and how much, s.

        Nobody drives a path again to the second.

        later, former: the sources whose rows they are.
        """
        none = mine[:0], 0.0
        if not len(mine) or not len(theirs):
            return none
        less, other = (mine, (former, theirs)) if len(mine) <= len(theirs) else (theirs, (later, mine))
        sample = less[:: max(1, len(less) // _SAMPLE)]
        if np.isfinite(self._nearest(sample, *other)[0]).sum() < _LEAST_OF_SAMPLE * len(sample):
            return none
        away, nearest = self._nearest(mine, former, theirs)
        met = np.flatnonzero(np.isfinite(away))
        if not len(met):
            return none
        off_s = self._time_s[mine[met]] - self._time_s[nearest[met]]
        middle = float(np.median(off_s))
        as_much = np.abs(off_s - middle) <= _CLOCKS_S
        if np.mean(as_much) < _NEARLY_ALL:
            return none
        return mine[met[as_much]], middle

    def _nearest(self, rows: NDArray[np.intp], source: int, among: NDArray[np.intp]) -> tuple[Array, NDArray[np.intp]]:
        """How far the nearest row of a source is, infinite where none is at the place, and which row it is."""
        if source not in self._trees:
            self._trees[source] = among, cKDTree(self._places[among])
        those, tree = self._trees[source]
        away, nearest = (np.asarray(one) for one in tree.query(self._places[rows], distance_upper_bound=2.0 * _PLACE_DEG))
        return away, those[np.minimum(nearest, len(those) - 1)]


def _held(table: HarvestTable, key: NDArray[np.int64], mine: NDArray[np.intp], theirs: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which of `mine` have the time, place and section of one of `theirs`."""
    order = theirs[np.argsort(key[theirs], kind="stable")]
    first = np.searchsorted(key[order], key[mine])
    found = np.zeros(len(mine), bool)
    section = np.nan_to_num(table["section"])
    for further in range(_MOST_AT_ONCE):
        place = first + further
        inside = place < len(order)
        row = order[np.minimum(place, max(len(order) - 1, 0))] if len(order) else mine
        inside &= len(order) > 0
        same = inside & (key[row] == key[mine]) & (section[row] == section[mine])
        for name in ("longitude_deg", "latitude_deg"):
            same &= np.abs(table[name][row] - table[name][mine]) <= _PLACE_DEG
        found |= same
        if not (inside & (key[row] == key[mine])).any():
            break
    return found
