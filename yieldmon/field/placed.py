"""Grain put back where it was cut: each row's mass moves to the row of its machine one delay before.

Whole where the rows come evenly. Where they do not, what a row measured over its interval is shared out among the rows whose
intervals, one delay before, overlap it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .table import Array, Flags, HarvestTable, Index
from .tracks import FAR_S, Tracks

_TOLERANCE_INTERVALS = 0.75
_EVEN_INTERVALS = 0.25
"""How far from the median an interval may be to count as even."""


@dataclass(frozen=True)
class Placed:
    """Mass and moisture of the grain at the place where it was cut.

    Parameters
    ----------
    measured_kg : array, shape (n,)
        Mass that each row measured; 0 where flow is not known.
    mass_kg : array, shape (n,)
        Mass cut at each row; NaN where none was measured for it.
    moisture_pct : array, shape (n,)
        Of that grain.
    flow_sd_kg_s : array, shape (n,)
        Standard deviation of that flow.
    from_row : array of int, shape (n,)
        A row that measured it, -1 for none.
    lost_kg : float
        Mass measured at times whose place is not in the record.
    """

    measured_kg: Array
    mass_kg: Array
    moisture_pct: Array
    flow_sd_kg_s: Array
    from_row: Index
    lost_kg: float


def measured_mass_kg(table: HarvestTable) -> Array:
    """Flow times interval; 0 where either is not known."""
    mass: Array = np.nan_to_num(table["flow_kg_s"] * table["interval_s"])
    return mass


def place(
    table: HarvestTable, steps: Tracks, flow_delay_s: float, moisture_delay_s: float, factor: Array | None = None
) -> Placed:
    """Mass and moisture at the places.

    Parameters
    ----------
    table, steps
        A harvest and its tracks.
    flow_delay_s, moisture_delay_s : float
        From cutting to the sensors.
    factor : array, shape (n,), optional
        What each row's mass is multiplied by (of its load).
    """
    mass = measured_mass_kg(table)
    if factor is not None:
        mass = mass * factor
    target = _targets(table, steps, flow_delay_s)
    shared = _shares(table, steps, target, flow_delay_s)
    target[shared.row] = -1
    again = repeated(table, steps)
    # A row recorded twice was cut once: the second stays where it is, and cleaning says why it is left out.
    target[again] = np.flatnonzero(again)
    shared = shared.without(again)
    going = target >= 0
    count = len(table)
    known = going & np.isfinite(table["flow_kg_s"])
    parts_kg = mass[shared.row] * shared.share
    known_part = np.isfinite(table["flow_kg_s"][shared.row])
    at_place = np.bincount(target[going], mass[going], count) + np.bincount(shared.target, parts_kg, count)
    arrived = np.bincount(target[known], minlength=count) + np.bincount(shared.target[known_part], minlength=count)
    from_row = np.full(count, -1, np.intp)
    by_share = np.argsort(shared.share, kind="stable")
    by_share = by_share[known_part[by_share]]
    from_row[shared.target[by_share]] = shared.row[by_share]
    from_row[target[known]] = np.flatnonzero(known)
    moisture = _moisture(table, steps, moisture_delay_s)
    sd = np.full(count, np.nan)
    has = from_row >= 0
    sd[has] = table["flow_sd_kg_s"][from_row[has]]
    lost_kg = max(0.0, float(mass[~going].sum() - parts_kg.sum()))
    return Placed(mass, np.where(arrived > 0, at_place, np.nan), moisture, sd, from_row, lost_kg)


def _moisture(table: HarvestTable, steps: Tracks, delay_s: float) -> Array:
    """Of the grain cut at each row; where no row comes to it, of the row whose interval holds the time when it was measured."""
    target = _targets(table, steps, delay_s)
    located = (target >= 0) & np.isfinite(table["moisture_pct"])
    moisture = np.full(len(table), np.nan)
    moisture[target[located]] = table["moisture_pct"][located]
    lacking = np.flatnonzero(np.isnan(moisture))
    step = steps.step_of_row[lacking]
    found = steps.holding(steps.time_s[step] + delay_s, steps.stream[step])
    moisture[lacking[found >= 0]] = steps.moisture_pct[found[found >= 0]]
    return moisture


def repeated(table: HarvestTable, steps: Tracks) -> Flags:
    """Rows whose time a row before them has, of the same machine and section."""
    section = np.nan_to_num(table["section"])
    stream = steps.stream[steps.step_of_row]
    order = np.lexsort((np.arange(len(table)), table["time_s"], section, stream))
    same = np.ones(max(len(order) - 1, 0), bool)
    for key in (table["time_s"], section, stream):
        same &= np.diff(key[order]) == 0
    out = np.zeros(len(table), bool)
    out[order[1:]] = same
    return out


@dataclass(frozen=True)
class _Shares:
    """Row `row` has the part `share` of its mass from row `target`; several of a row."""

    row: Index
    target: Index
    share: Array

    def without(self, rows: Flags) -> _Shares:
        left = ~rows[self.row]
        return _Shares(self.row[left], self.target[left], self.share[left])


def _shares(table: HarvestTable, steps: Tracks, target: Index, delay_s: float) -> _Shares:
    """Where the grain of rows was cut that come unevenly, or whose place is a row that does."""
    interval_s = np.nan_to_num(table["interval_s"])
    if abs(delay_s) < 0.5 * steps.usual_interval_s or not len(table):
        return _Shares(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0))
    even = np.abs(interval_s - steps.usual_interval_s) <= _EVEN_INTERVALS * steps.usual_interval_s
    has_clock = 2 * np.count_nonzero(even) > len(table)
    whole = has_clock & even & (target >= 0) & even[np.maximum(target, 0)]
    row = np.flatnonzero(~whole & (interval_s > 0))
    # As far as rows move that are moved whole.
    shift_s = round(delay_s / steps.usual_interval_s) * steps.usual_interval_s if has_clock else delay_s
    base_s = float(steps.time_s.min())
    span_s = float(steps.time_s.max()) - base_s + 2.0 * abs(shift_s) + FAR_S
    end = steps.stream * span_s + (steps.time_s - base_s)
    begin = np.maximum(end - steps.interval_s, np.r_[-np.inf, end[:-1]])
    step = steps.step_of_row[row]
    to = steps.stream[step] * span_s + (steps.time_s[step] - base_s) - shift_s
    since = to - interval_s[row]
    first = np.searchsorted(end, since, side="right")
    number = np.maximum(np.searchsorted(begin, to, side="left") - first, 0)
    part = np.repeat(np.arange(len(row)), number)
    found = first[part] + np.arange(len(part)) - np.repeat(np.cumsum(number) - number, number)
    overlap_s = np.minimum(to[part], end[found]) - np.maximum(since[part], begin[found])
    there = _rows_at(table, steps, found, row[part])
    good = (overlap_s > 0) & (there >= 0)
    return _Shares(row[part][good], there[good], (overlap_s / interval_s[row[part]])[good])


def _targets(table: HarvestTable, steps: Tracks, delay_s: float) -> Index:
    """The row where the grain of each row was cut, -1 for none."""
    count = len(table)
    step = steps.step_of_row
    tolerance = _TOLERANCE_INTERVALS * max(steps.usual_interval_s, 1e-6)
    if abs(delay_s) < 0.5 * steps.usual_interval_s:
        return np.arange(count)
    # Steps do not merge: to the same nearest number of intervals as all others of an even clock.
    found = steps.nearest(steps.time_s - delay_s, steps.stream, tolerance)[step]
    return _rows_at(table, steps, found, np.arange(count))


def _rows_at(table: HarvestTable, steps: Tracks, found: Index, row: Index) -> Index:
    """Of each step found for a row, the row of the same section; -1 where there is none."""
    count = len(table)
    step = steps.step_of_row
    if len(steps) == count:
        row_of_step = np.empty(count, np.intp)
        row_of_step[step] = np.arange(count)
        return np.where(found >= 0, row_of_step[np.maximum(found, 0)], -1)
    sections, code = np.unique(np.nan_to_num(table["section"]), return_inverse=True)
    keys = step * len(sections) + code
    order = np.argsort(keys, kind="stable")
    wanted = found * len(sections) + code[row]
    place_in = np.clip(np.searchsorted(keys[order], wanted), 0, count - 1)
    hit = (found >= 0) & (keys[order][place_in] == wanted)
    return np.where(hit, order[place_in], -1)
