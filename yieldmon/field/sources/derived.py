"""Intervals, ways and flows that a file does not have, from what it has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.errors import InputError
from yieldmon.field.plane import Sites
from yieldmon.field.table import Array
from yieldmon.field.tracks import GAP_INTERVALS, usual_steps

_FASTEST_M_S, _BESIDE_M = 15.0, 5.0
"""Of a combine on a road, and metres beside it, beyond which a place that is left again at once is no place."""
_MOST_ASTRAY, _LONGEST_BRIDGE = 3, 6
"""Rows one after another that may be astray, and rows from one known place to the next between which the way is even."""
_DISAGREE = 1.33
"""Times that flow and yield may differ: grain as weighed and dried by a fifth."""
_LEAST_ROWS = 30


def derive(values: dict[str, Array], time_s: Array, machine: NDArray[np.int32], where: str) -> tuple[str, ...]:
    """Adds interval, distance and flow to values where they are missing, between rows of one machine and section; notes.

    Parameters
    ----------
    values : dict of str to array, shape (n,)
        Quantity -> values in SI, NaN where not known.
    time_s : array, shape (n,)
        Of each row.
    machine : array of int, shape (n,)
        That made each row.
    where : str
        Place for errors.

    Raises
    ------
    InputError
        Where there is neither flow nor yield.
    """
    count = len(time_s)
    section = np.nan_to_num(values.get("section", np.zeros(count)))
    order = np.lexsort((np.arange(count), time_s, section, machine))
    before = np.full(count, -1)
    before[order[1:]] = order[:-1]
    joined = (before >= 0) & (section == section[before]) & (machine == machine[before])
    step = np.where(joined, time_s - time_s[before], np.nan)
    usual = np.empty(count)
    usual[order] = usual_steps(step[order], ~joined[order])
    steady = (step >= 0) & (step <= GAP_INTERVALS * usual)
    if "interval" not in values:
        values["interval"] = np.where(steady, step, usual)
    if "distance" not in values:
        if "speed" in values:
            values["distance"] = values["speed"] * values["interval"]
        else:
            stream = np.cumsum(~joined[order]) - 1
            x, y = np.empty(count), np.empty(count)
            x[order], y[order] = bridged(values["longitude"][order], values["latitude"][order], time_s[order], stream)
            way = np.where(steady, np.hypot(x - x[before], y - y[before]), np.nan)
            after = np.full(count, np.nan)
            after[order[:-1]] = way[order[1:]]
            values["distance"] = np.where(np.isfinite(way), way, after)
    if "yield" not in values:
        if "flow" not in values:
            raise InputError(where, "has neither flow nor yield", "--column flow=NAME:UNIT or yield=NAME:UNIT")
        return ()
    area = values["distance"] * values["width"]
    with np.errstate(invalid="ignore", divide="ignore"):
        flow = np.where(values["interval"] > 0, values["yield"] * area / values["interval"], np.nan)
    if "flow" in values:
        return _disagreement(values["flow"], flow)
    values["flow"] = flow
    up = values["header"] == 0 if "header" in values else np.zeros(count, bool)
    lost = (values["yield"] > 0) & ~up & (~np.isfinite(area) | (values["width"] == 0))
    return (f"{int(lost.sum())} rows have a yield and no width or way: their grain is not counted",) if lost.any() else ()


def _disagreement(flow: Array, from_yield: Array) -> tuple[str, ...]:
    """A note where a file's flow and yield are not of one harvest."""
    both = (flow > 0) & (from_yield > 0)
    if both.sum() < _LEAST_ROWS:
        return ()
    times = float(np.median(flow[both] / from_yield[both]))
    if 1.0 / _DISAGREE <= times <= _DISAGREE:
        return ()
    return (f"its flow says {times:.2g} times what its yield says; the flow is used; expected another unit of one (--column)",)


def bridged(longitude: Array, latitude: Array, time_s: Array, stream: NDArray[np.intp]) -> tuple[Array, Array]:
    """Places on a plane, m, with those that are not known, or that are left again at once faster than a machine drives, between
    the ones beside them.

    Parameters
    ----------
    longitude, latitude : array, shape (n,)
        In deg, in order of stream and time.
    time_s : array, shape (n,)
    stream : array of int, shape (n,)
        Machine and section.
    """
    x, y = Sites.about(longitude, latitude).to_m(longitude, latitude)
    for rows in np.split(np.arange(len(x)), np.flatnonzero(np.diff(stream)) + 1):
        own_x, own_y, own_s = x[rows], y[rows], time_s[rows]
        astray = _astray(own_x, own_y, own_s)
        known = np.flatnonzero(np.isfinite(own_x) & np.isfinite(own_s) & ~astray)
        if not known.size or known.size == len(rows):
            continue
        missing = np.setdiff1d(np.flatnonzero(np.isfinite(own_s)), known)
        right = np.searchsorted(known, missing)
        inside = (right > 0) & (right < known.size)
        near = known[np.minimum(right, known.size - 1)] - known[np.maximum(right - 1, 0)] <= _LONGEST_BRIDGE
        at = missing[inside & near]
        own_x[missing], own_y[missing] = np.nan, np.nan
        own_x[at], own_y[at] = (np.interp(own_s[at], own_s[known], places[known]) for places in (own_x, own_y))
        x[rows], y[rows] = own_x, own_y
    return x, y


def _astray(x: Array, y: Array, time_s: Array) -> NDArray[np.bool_]:
    """Up to three rows one after another to which and from which no machine drives, while the rows around them go on."""
    out = np.zeros(len(x), bool)

    def leaps(one: NDArray[np.intp], other: NDArray[np.intp]) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            leap = np.hypot(x[other] - x[one], y[other] - y[one]) > _FASTEST_M_S * np.abs(time_s[other] - time_s[one]) + _BESIDE_M
        return np.asarray(leap)

    for long in range(1, _MOST_ASTRAY + 1):
        first = np.arange(1, len(x) - long)
        known = np.isfinite(x[first - 1]) & np.isfinite(x[first + long])
        found = first[known & leaps(first - 1, first) & leaps(first + long - 1, first + long) & ~leaps(first - 1, first + long)]
        for further in range(long):
            out[found + further] = True
    return out
