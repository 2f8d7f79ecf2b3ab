"""The rules by which points are left out of a map: functions from a context to flags, with thresholds from the same source.

To add a rule, write it and list it in RULES; each can be switched off by its name.

Sources: Sudduth, Drummond and Myers, "Yield Editor 2.0", ASABE paper 121338243 (2012); Spekken, Anselmi and Molin, "A simple
method for filtering spatial data" (2013); Vega et al., "Protocol for automating error removal from yield maps", Precision
Agriculture 20 (2019), for local outliers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .neighbours import shared
from .placed import Placed
from .plane import APART_M, astray
from .table import Array, Flags, HarvestTable, Index
from .tracks import MIN_SPEED_M_S, Tracks

if TYPE_CHECKING:
    from .swath import Swaths  # which needs the extra `map`

# Thresholds that reports name stand in RULES with what they are of.
_MAX_RAMP_S = 20.0
"""At most left out at the start and at the end of a pass."""
_RAMP_LEVEL = 0.95
_AFTER_S = 10.0
"""The yield of a pass's start is held against that of so long after it."""
_TURN_DEG = 30.0
_SPEED_STEP = 0.25
_SHORT_PASS_WIDTHS = 3.0
_FENCE = 3.0
"""Interquartile ranges from the quartiles to Tukey's outer fences."""
_MIN_NEW_SHARE = 0.5
_JUMP_TIMES = 3.0


@dataclass(frozen=True)
class Context:
    """What rules look at; rows of the table."""

    table: HarvestTable
    steps: Tracks
    placed: Placed
    ground: Swaths

    def of_step(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """A step's value in each of its rows."""
        return values[self.steps.step_of_row]

    def of_rows(self, rows: Index) -> Context:
        """The same of some rows."""
        mass, moisture = self.placed.mass_kg[rows], self.placed.moisture_pct[rows]
        gross, area = self.ground.gross_m2[rows], self.ground.area_m2[rows]
        return Context(
            self.table.take(rows),
            self.steps.of_rows(rows),
            replace(self.placed, mass_kg=mass, moisture_pct=moisture),
            replace(self.ground, gross_m2=gross, area_m2=area),
        )

    @cached_property
    def yield_kg_m2(self) -> Array:
        """Mass over new ground; NaN without either."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.ground.area_m2 > 0, self.placed.mass_kg / self.ground.area_m2, np.nan)

    @cached_property
    def gross_yield_kg_m2(self) -> Array:
        """Mass over the whole swath."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.ground.gross_m2 > 0, self.placed.mass_kg / self.ground.gross_m2, np.nan)

    @cached_property
    def along(self) -> tuple[Array, Array]:
        """Seconds since the start of the pass and to its end, of each step."""
        number, time = self.steps.pass_number, self.steps.time_s
        since, till = np.full(len(time), np.inf), np.full(len(time), np.inf)
        inside = np.flatnonzero(number >= 0)
        if len(inside):
            edge = np.flatnonzero(np.diff(number[inside], prepend=-2))
            first = time[inside][edge][np.searchsorted(edge, np.arange(len(inside)), side="right") - 1]
            ends = np.append(edge[1:], len(inside)) - 1
            last = time[inside][ends][np.searchsorted(edge, np.arange(len(inside)), side="right") - 1]
            since[inside], till[inside] = time[inside] - first, last - time[inside]
        return since, till


def _no_position(at: Context) -> Flags:
    return ~np.isfinite(at.table["longitude_deg"]) | ~np.isfinite(at.table["time_s"])


def _far(at: Context) -> Flags:
    return astray(at.steps.row_x_m)


def _no_flow(at: Context) -> Flags:
    return ~np.isfinite(at.placed.mass_kg)


def _header_up(at: Context) -> Flags:
    return np.asarray(~np.asarray(at.of_step(at.steps.down), bool) | (at.table["header_down"] == 0))


def _duplicate(at: Context) -> Flags:
    """The same time again, or the same place at another time, of one section."""
    section = np.nan_to_num(at.table["section"])
    stream = at.of_step(at.steps.stream)
    again = np.zeros(len(at.table), bool)
    place = np.round(at.steps.row_x_m * 100), np.round(at.steps.row_y_m * 100)
    for keys in ((at.table["time_s"], section, stream), (*place, section)):
        order = np.lexsort((np.arange(len(section)), *keys))
        same = np.ones(len(order) - 1 if len(order) else 0, bool)
        for key in keys:
            same &= np.diff(np.asarray(key, float)[order]) == 0
        again[order[1:]] |= same
    return again


def _jump(at: Context) -> Flags:
    """A step that is further than the speeds of this field allow, and the one after it."""
    steps = at.steps
    distance_m = np.hypot(np.diff(steps.x_m, prepend=np.nan), np.diff(steps.y_m, prepend=np.nan))
    time = np.diff(steps.time_s, prepend=np.nan)
    joined = np.diff(steps.run, prepend=-1) == 0
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = np.where(joined & (time > 0), distance_m / time, np.nan)
    usual = speed[np.isfinite(speed) & steps.down & (speed > MIN_SPEED_M_S)]
    if not usual.size:
        return np.zeros(len(at.table), bool)
    limit = _JUMP_TIMES * float(np.percentile(usual, 90))
    jumped = np.nan_to_num(speed) > limit
    return np.asarray(at.of_step(jumped), bool)


def _stopped(at: Context) -> Flags:
    speed = np.nan_to_num(at.steps.speed_m_s)
    driven = speed[at.steps.down & (speed > MIN_SPEED_M_S)]
    usual = float(np.median(driven)) if driven.size else 0.0
    slow = speed < max(MIN_SPEED_M_S, 0.2 * usual)
    return np.asarray(at.of_step(slow), bool)


def _speed_step(at: Context) -> Flags:
    steps = at.steps
    speed = steps.speed_m_s
    change = np.abs(np.diff(speed, prepend=np.nan))
    joined = np.diff(steps.run, prepend=-1) == 0
    usual = change[joined & steps.down & np.isfinite(change)]
    if not usual.size:
        return np.zeros(len(at.table), bool)
    level = np.nanmedian(speed[steps.down])
    limit = max(_SPEED_STEP * level, 8.0 * float(np.median(usual)), float(np.percentile(usual, 98)))
    return np.asarray(at.of_step(joined & (np.nan_to_num(change) > limit)), bool)


def _turn(at: Context) -> Flags:
    """The heading two steps on and two steps back differ."""
    heading = at.steps.heading_rad
    count = len(heading)
    if count < 5:
        return np.zeros(len(at.table), bool)
    index = np.arange(count)
    before, after = np.maximum(index - 2, 0), np.minimum(index + 2, count - 1)
    same = (at.steps.run[before] == at.steps.run) & (at.steps.run[after] == at.steps.run)
    with np.errstate(invalid="ignore"):
        turned = np.cos(heading[after] - heading[before]) < np.cos(np.radians(_TURN_DEG))
    return np.asarray(at.of_step(same & turned), bool)


def _short_pass(at: Context) -> Flags:
    steps = at.steps
    inside = steps.pass_number >= 0
    if not inside.any():
        return np.zeros(len(at.table), bool)
    count = int(steps.pass_number.max()) + 1
    distance_m = np.bincount(steps.pass_number[inside], np.nan_to_num(steps.speed_m_s * steps.interval_s)[inside], count)
    short = distance_m < _SHORT_PASS_WIDTHS * float(np.median(steps.width_m[inside]))
    return np.asarray(at.of_step(inside & short[np.maximum(steps.pass_number, 0)]), bool)


def ramp_s(distance_s: Array, level: Array) -> float:
    """How long yields rise, s from an end: to the first second whose median yield is RAMP_LEVEL of that of the seconds after it.

    Ground at the field's edge that yields less, evenly, is no ramp.

    >>> ramp_s(np.repeat(np.arange(40.0), 20), np.repeat(np.minimum(np.arange(40.0) / 4.0, 1.0), 20))
    4.0
    >>> ramp_s(np.repeat(np.arange(40.0), 20), np.repeat(np.where(np.arange(40.0) < 12.0, 0.8, 1.0), 20))
    0.0
    """
    known = np.isfinite(level) & np.isfinite(distance_s)
    if np.count_nonzero(known & (distance_s > _MAX_RAMP_S)) < 100:
        return 0.0
    near = known & (distance_s < _MAX_RAMP_S + _AFTER_S + 1.0)
    distance, values = distance_s[near], level[near]
    for second in range(int(_MAX_RAMP_S)):
        here = values[(distance >= second) & (distance < second + 1)]
        after = values[(distance >= second + 1) & (distance < second + 1 + _AFTER_S)]
        if here.size < 5 or not after.size or float(np.median(here)) >= _RAMP_LEVEL * float(np.median(after)):
            return float(second)
    return _MAX_RAMP_S


def _pass_start(at: Context) -> Flags:
    since = at.along[0][at.steps.step_of_row]
    return since < ramp_s(since, at.gross_yield_kg_m2)


def _pass_end(at: Context) -> Flags:
    till = at.along[1][at.steps.step_of_row]
    return till < ramp_s(till, at.gross_yield_kg_m2)


def fences(values: Array) -> tuple[float, float]:
    """Tukey's outer fences; all is inside where less than 20 values are known."""
    known = values[np.isfinite(values)]
    if known.size < 20:
        return -np.inf, np.inf
    low, high = np.percentile(known, [25, 75])
    return float(low - _FENCE * (high - low)), float(high + _FENCE * (high - low))


def _flow(at: Context) -> Flags:
    mass = at.placed.mass_kg
    down = np.asarray(at.of_step(at.steps.down), bool)
    usable = down & (np.nan_to_num(mass) > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        rate = np.where(down & (at.table["interval_s"] > 0), mass / at.table["interval_s"] / at.table["width_m"], np.nan)
        # By the width that was newly cut: beside passes that overlap a whole width is no outlier.
        share = np.where(usable, at.ground.area_m2 / at.ground.gross_m2, np.nan)
        high = usable & (rate > fences(np.where(share >= _MIN_NEW_SHARE, rate / share, np.nan))[1])
    empty = _between_grain(at, usable) & (mass == 0) & (at.table["header_down"] > 0)
    return (~usable | high) & ~shared(at.steps, rate, high | empty)


def _between_grain(at: Context, grain: Flags) -> Flags:
    """Rows of a pass after the first and before the last with grain: before the first none has come yet."""
    number = np.asarray(at.of_step(at.steps.pass_number), np.intp)
    time_s = np.asarray(at.of_step(at.steps.time_s), float)
    inside = number >= 0
    count = int(number.max(initial=0)) + 1
    first, last = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(first, number[inside & grain], time_s[inside & grain])
    np.maximum.at(last, number[inside & grain], time_s[inside & grain])
    out = np.zeros(len(number), bool)
    out[inside] = (time_s > first[number.clip(0)])[inside] & (time_s < last[number.clip(0)])[inside]
    return out


def _moisture(at: Context) -> Flags:
    moisture = at.placed.moisture_pct
    inside = np.where(np.asarray(at.of_step(at.steps.down), bool), moisture, np.nan)
    low, high = fences(inside)
    known = np.isfinite(moisture)
    spread = 1e-9 if not np.isfinite(high) else 0.5
    return known & ((moisture < low - spread) | (moisture > high + spread))


def _overlap(at: Context) -> Flags:
    return (at.ground.gross_m2 > 0) & (at.ground.area_m2 < _MIN_NEW_SHARE * at.ground.gross_m2)


def _yield(at: Context) -> Flags:
    low, high = fences(np.where(_overlap(at), np.nan, at.yield_kg_m2))
    amount = at.yield_kg_m2
    with np.errstate(invalid="ignore"):
        beyond = (amount < low) | (amount > high)
    return ~np.isfinite(amount) | (beyond & ~shared(at.steps, amount, beyond))


@dataclass(frozen=True)
class Rule:
    """name: as in the reason column. about: one line for people. flags: the rule. across: of all rows, not source by source."""

    name: str
    about: str
    flags: Callable[[Context], Flags]
    across: bool = False


RULES: tuple[Rule, ...] = (
    Rule("no position", "no position or time", _no_position),
    Rule("far away", f"over {APART_M / 1000:.0f} km from every field", _far),
    Rule("no flow", "no flow was measured for the place", _no_flow),
    Rule("header up", "not harvesting", _header_up),
    Rule("duplicate", "time or place of another point", _duplicate, across=True),
    Rule("position jump", f"over {_JUMP_TIMES:g} times the speed of the field", _jump),
    Rule("stopped", "slower than a fifth of the usual speed", _stopped),
    Rule("short pass", f"pass shorter than {_SHORT_PASS_WIDTHS:g} widths", _short_pass),
    Rule("turn", f"heading changes by over {_TURN_DEG:g} deg within four points", _turn),
    Rule("speed step", f"speed changes by over {100 * _SPEED_STEP:g} % and far more than usual from point to point", _speed_step),
    Rule("pass start", f"yield not yet at {100 * _RAMP_LEVEL:g} % of what follows (length from all passes)", _pass_start),
    Rule("pass end", f"yield no longer at {100 * _RAMP_LEVEL:g} % of what was before", _pass_end),
    Rule("overlap", "over half of the swath was cut before", _overlap),
    Rule("flow", "no flow, or above the outer fence of flow by width, and adjacent passes do not show the same", _flow),
    Rule("moisture", "beyond the outer fences", _moisture),
    Rule("yield", "beyond the outer fences, and adjacent passes do not show the same", _yield),
)
