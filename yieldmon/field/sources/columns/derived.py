"""Intervals, distances and flows that a file does not have, derived from what it has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.errors import InputError
from yieldmon.field.leaps import bridged
from yieldmon.field.plane import astray, places_m
from yieldmon.field.table import Array, Flags, Index
from yieldmon.field.tracks import GAP_INTERVALS, usual_steps
from yieldmon.units import counted

_DISAGREE = 1.33
"""Factor by which flow and yield may differ: wet grain, and grain dried by a fifth."""
_LEAST_ROWS = 30


def derive(values: dict[str, Array], time_s: Array, machine: NDArray[np.int32], where: str) -> tuple[str, ...]:
    """Add interval, distance and flow to `values` where they are missing, from row to row of one machine and section.

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

    Returns
    -------
    tuple of str
        Notes.

    Raises
    ------
    InputError
        Where there is neither flow nor yield.
    """
    rows = _rows_before(values, time_s, machine)
    if "interval" not in values:
        values["interval"] = np.where(rows.steady, rows.step_s, rows.usual_s)
    if "distance" not in values:
        values["distance"] = values["speed"] * values["interval"] if "speed" in values else _distances(values, time_s, rows)
    if "mass" in values:
        values["flow"] = _per_s(values["mass"], values["interval"])
        return ()
    if "yield" not in values:
        if "flow" not in values:
            raise InputError(where, "has neither flow nor yield", "--column flow=NAME:UNIT or yield=NAME:UNIT")
        return ()
    area = values["distance"] * values["width"]
    flow = _per_s(values["yield"] * area, values["interval"])
    if "flow" in values:
        return _disagreement(values["flow"], flow)
    values["flow"] = flow
    up = values["header"] == 0 if "header" in values else np.zeros(len(time_s), bool)
    lost = (values["yield"] > 0) & ~up & (~np.isfinite(area) | (values["width"] == 0))
    return (
        (f"{counted(int(lost.sum()), 'row')} with a yield and no width or distance: their grain is not counted",)
        if lost.any()
        else ()
    )


@dataclass(frozen=True)
class _RowsBefore:
    """Each row and the one before it of the same machine and section.

    Parameters
    ----------
    order : array of int, shape (n,)
        Rows by machine, section and time.
    before : array of int, shape (n,)
        The row before each in that order; -1 for the first.
    joined : array of bool, shape (n,)
        Whether that is of the same machine and section.
    step_s, usual_s : array, shape (n,)
        Time since the row before, NaN where there is none; and the usual one about the row.
    steady : array of bool, shape (n,)
        Rows without a gap before them.
    """

    order: Index
    before: Index
    joined: Flags
    step_s: Array
    usual_s: Array
    steady: Flags


def _rows_before(values: dict[str, Array], time_s: Array, machine: NDArray[np.int32]) -> _RowsBefore:
    count = len(time_s)
    section = np.nan_to_num(values.get("section", np.zeros(count)))
    order = np.lexsort((np.arange(count), time_s, section, machine))
    before = np.full(count, -1)
    before[order[1:]] = order[:-1]
    joined = (before >= 0) & (section == section[before]) & (machine == machine[before])
    step = np.where(joined, time_s - time_s[before], np.nan)
    usual = np.empty(count)
    usual[order] = usual_steps(step[order], ~joined[order])
    return _RowsBefore(order, before, joined, step, usual, (step >= 0) & (step <= GAP_INTERVALS * usual))


def _distances(values: dict[str, Array], time_s: Array, rows: _RowsBefore) -> Array:
    """Distance from the row before, by the places; after a gap that to the row after; m."""
    count, order = len(time_s), rows.order
    stream = np.cumsum(~rows.joined[order]) - 1
    x, y = np.empty(count), np.empty(count)
    longitude, latitude = values["longitude"][order], values["latitude"][order]
    east, north = places_m(longitude, latitude)
    x[order], y[order] = bridged(np.where(astray(east), np.nan, east), north, time_s[order], stream)
    distance = np.where(rows.steady, np.hypot(x - x[rows.before], y - y[rows.before]), np.nan)
    after = np.full(count, np.nan)
    after[order[:-1]] = distance[order[1:]]
    return np.where(np.isfinite(distance), distance, after)


def _per_s(amount: Array, interval_s: Array) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(interval_s > 0, amount / interval_s, np.nan)


def _disagreement(flow: Array, from_yield: Array) -> tuple[str, ...]:
    """A note where a file's flow and yield contradict each other."""
    both = (flow > 0) & (from_yield > 0)
    if both.sum() < _LEAST_ROWS:
        return ()
    times = float(np.median(flow[both] / from_yield[both]))
    if 1.0 / _DISAGREE <= times <= _DISAGREE:
        return ()
    note = f"its flow is {times:.2g} times the flow that its yield gives; the flow is used"
    return (f"{note}; expected another unit for one of them (--column)",)
