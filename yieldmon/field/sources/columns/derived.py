"""Intervals, ways and flows that a file does not have, from what it has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.errors import InputError
from yieldmon.field.leaps import bridged
from yieldmon.field.plane import Sites, astray
from yieldmon.field.table import Array
from yieldmon.field.tracks import GAP_INTERVALS, usual_steps

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
            longitude, latitude = values["longitude"][order], values["latitude"][order]
            east, north = Sites.about(longitude, latitude).to_m(longitude, latitude)
            x[order], y[order] = bridged(np.where(astray(east), np.nan, east), north, time_s[order], stream)
            way = np.where(steady, np.hypot(x - x[before], y - y[before]), np.nan)
            after = np.full(count, np.nan)
            after[order[:-1]] = way[order[1:]]
            values["distance"] = np.where(np.isfinite(way), way, after)
    if "mass" in values:
        with np.errstate(invalid="ignore", divide="ignore"):
            values["flow"] = np.where(values["interval"] > 0, values["mass"] / values["interval"], np.nan)
        return ()
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
