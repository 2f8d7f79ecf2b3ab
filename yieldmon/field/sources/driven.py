"""Distances and speeds of a file held against its positions: a sum that goes on is taken apart, a wrong unit is named."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.field.plane import Sites
from yieldmon.field.table import Array

from .positions import plausible
from .raw_table import Raw

_LEAST_ROWS = 30
"""Of which a median says something."""
_RISING = 0.98
"""Share of a machine's rows from which a distance that never falls is a sum."""
_FAR_OFF = 1.6
"""Times that distances may differ from positions: a knot is 1.15 miles an hour and 1.85 km/h."""
_HIGHEST_DEG, _UNLIKE = 85.0, 0.15
"""Latitude up to which fields are looked for, and how unlike (log) ways to the east and the north must be."""
_LEAST_M = 0.3
"""Between two positions, that they say something."""


def ways_checked(raw: Raw, values: dict[str, Array], time_s: Array) -> tuple[str, ...]:
    """Notes on distances and speeds that do not agree with the positions. A distance that is a sum becomes one of each row.

    Parameters
    ----------
    raw : Raw
        As read, each machine's rows under its own name.
    values : dict of str to array, shape (n,)
        Quantity -> values in SI; a distance may be replaced.
    time_s : array, shape (n,)
        Of each row.
    """
    if "section" in values or not {"distance", "speed"} & set(values):
        return ()
    apart_m, step_s = _apart(raw, values, time_s)
    notes: list[str] = []
    if "distance" in values:
        each = _each(raw, values["distance"], time_s)
        if each is not None and _times(each, apart_m) is not None:
            values["distance"] = each
            notes.append(f"{raw.columns['distance'].name} is a sum that goes on: its differences are the distances")
    interval_s = values.get("interval", step_s)
    driven = {"distance": values["distance"]} if "distance" in values else {"speed": values["speed"] * interval_s}
    for quantity, way_m in driven.items():
        times = _times(way_m, apart_m)
        if times is not None and not 1.0 / _FAR_OFF < times < _FAR_OFF:
            name = raw.columns[quantity].name
            mend = f"--column {quantity}={name}:UNIT"
            notes.append(f"{name}: says {times:.2g} times the way between positions; expected another unit ({mend})")
        if _are_swapped(raw, values, way_m, time_s):
            notes.append(
                f"longitude and latitude seem exchanged: only then does {raw.columns[quantity].name} fit the ways between them"
            )
    return tuple(notes)


def _are_swapped(raw: Raw, values: dict[str, Array], way_m: Array, time_s: Array) -> bool:
    """Whether ways to the east and to the north fit equally well only where longitude and latitude are exchanged."""
    exchanged = values | {"longitude": values["latitude"], "latitude": values["longitude"]}
    if not np.nanmax(np.abs(exchanged["latitude"]), initial=0.0) <= _HIGHEST_DEG:
        return False
    as_they_are, other = (_east_to_north(raw, one, way_m, time_s) for one in (values, exchanged))
    if as_they_are is None or other is None:
        return False
    unlike, exchanged_unlike = abs(float(np.log(as_they_are))), abs(float(np.log(other)))
    return unlike > _UNLIKE and exchanged_unlike < 0.25 * unlike


def _east_to_north(raw: Raw, values: dict[str, Array], way_m: Array, time_s: Array) -> float | None:
    """How many times better ways to the east than to the north agree with positions, in the medians; None where too few tell."""
    places, _ = plausible({"longitude_deg": values["longitude"], "latitude_deg": values["latitude"]})
    x, y = Sites.about(places["longitude_deg"], places["latitude_deg"]).to_m(places["longitude_deg"], places["latitude_deg"])
    found = []
    for along, across in ((x, y), (y, x)):
        ratios = []
        for rows in _orders(raw, time_s):
            step, beside = np.abs(np.diff(along[rows])), np.abs(np.diff(across[rows]))
            with np.errstate(invalid="ignore"):
                told = (step > _LEAST_M) & (beside < 0.3 * step) & (way_m[rows][1:] > 0)
            ratios.append(way_m[rows][1:][told] / step[told])
        ratio = np.concatenate(ratios)
        if ratio.size < _LEAST_ROWS:
            return None
        found.append(float(np.median(ratio)))
    return found[0] / found[1]


def _orders(raw: Raw, time_s: Array) -> list[NDArray[np.intp]]:
    """The rows of each machine by time."""
    order = np.lexsort((np.arange(raw.count), time_s, raw.machine_of_row))
    return np.split(order, np.flatnonzero(np.diff(raw.machine_of_row[order])) + 1)


def _apart(raw: Raw, values: dict[str, Array], time_s: Array) -> tuple[Array, Array]:
    """From each row to the one before it of its machine, m, and s."""
    places, _ = plausible({"longitude_deg": values["longitude"], "latitude_deg": values["latitude"]})
    x, y = Sites.about(places["longitude_deg"], places["latitude_deg"]).to_m(places["longitude_deg"], places["latitude_deg"])
    apart_m, step_s = np.full(raw.count, np.nan), np.full(raw.count, np.nan)
    for rows in _orders(raw, time_s):
        apart_m[rows[1:]] = np.hypot(np.diff(x[rows]), np.diff(y[rows]))
        step_s[rows[1:]] = np.diff(time_s[rows])
    return apart_m, step_s


def _each(raw: Raw, distance_m: Array, time_s: Array) -> Array | None:
    """Differences of a distance that never falls; None for any other."""
    each = np.full(raw.count, np.nan)
    rising = moving = 0
    for rows in _orders(raw, time_s):
        steps = np.diff(distance_m[rows])
        each[rows[1:]] = np.where(steps >= 0, steps, np.nan)
        each[rows[:1]] = each[rows[1:2]] if len(rows) > 1 else 0.0
        rising += int((steps >= 0).sum())
        moving += int((steps > 0).sum())
    count = raw.count - len(_orders(raw, time_s))
    return each if count >= _LEAST_ROWS and rising >= _RISING * count and moving >= 0.5 * count else None


def _times(way_m: Array, apart_m: Array) -> float | None:
    """How many times the way between positions these ways are, in the median; None where too few tell."""
    with np.errstate(invalid="ignore"):
        told = np.isfinite(way_m) & (way_m > 0) & (apart_m > _LEAST_M)
    return float(np.median(way_m[told] / apart_m[told])) if told.sum() >= _LEAST_ROWS else None
