"""Distances and speeds of a file held against its positions: a sum that goes on is taken apart, a wrong unit is named."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.field.groups import by_time
from yieldmon.field.plane import places_m
from yieldmon.field.table import Array

from .positions import HIGHEST_DEG, plausible
from .raw_table import Raw

_LEAST_ROWS = 30
"""Of which a median says something."""
_RISING = 0.98
"""Share of a machine's rows from which a distance that never falls is a sum."""
_FAR_OFF = 1.6
"""Times that distances may differ from positions: a knot is 1.15 miles an hour and 1.85 km/h."""
_UNLIKE = 0.15
"""How unlike (log) distances to the east and the north must be."""
LEAST_M = 0.3
"""Between two positions, that they say something."""
_SPAN_M, _MOST_ROWS, _STRAIGHT = 40.0, 30, 0.98
"""Length of a stretch, its rows at most, and how near to a straight line it is."""
_LEAST_SPANS, _LEAST_TURN = 10, 0.3
"""Stretches that tell, and by how much the share of the east differs between them."""


def distances_checked(raw: Raw, values: dict[str, Array], time_s: Array) -> tuple[str, ...]:
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
    x_m, y_m = _plane(values)
    notes: list[str] = []
    if "distance" in values:
        each = each_of_a_sum(raw, values["distance"], time_s)
        if each is not None and _straight(raw, (x_m, y_m), each, time_s) is not None:
            values["distance"] = each
            notes.append(f"{raw.columns['distance'].name} is a running total: its differences are used as distances")
    interval_s = values.get("interval", _steps(raw, time_s))
    driven = {"distance": values["distance"]} if "distance" in values else {"speed": values["speed"] * interval_s}
    for quantity, distance_m in driven.items():
        name = raw.columns[quantity].name
        spans = _straight(raw, (x_m, y_m), distance_m, time_s)
        times = None if spans is None else float(np.median(spans.distance_m / np.hypot(spans.east_m, spans.north_m)))
        if times is not None and not 1.0 / _FAR_OFF < times < _FAR_OFF:
            mend = f"--column {quantity}={name}:UNIT"
            notes.append(f"{name}: is {times:.2g} times the distance between positions; expected another unit ({mend})")
        if _are_swapped(raw, values, distance_m, time_s):
            notes.append(f"longitude and latitude seem exchanged: only then does {name} fit the distances between them")
    return tuple(notes)


def _are_swapped(raw: Raw, values: dict[str, Array], distance_m: Array, time_s: Array) -> bool:
    """Whether distances to the east and to the north fit equally well only where longitude and latitude are exchanged."""
    exchanged = values | {"longitude": values["latitude"], "latitude": values["longitude"]}
    if not np.nanmax(np.abs(exchanged["latitude"]), initial=0.0) <= HIGHEST_DEG:
        return False
    as_they_are, other = (_east_to_north(_straight(raw, _plane(one), distance_m, time_s)) for one in (values, exchanged))
    if as_they_are is None or other is None:
        return False
    unlike, exchanged_unlike = abs(float(np.log(as_they_are))), abs(float(np.log(other)))
    return unlike > _UNLIKE and exchanged_unlike < 0.25 * unlike


def _east_to_north(spans: _Spans | None) -> float | None:
    """How many times better distances to the east than to the north agree with positions; None where too few tell.

    The square of the distance is a sum of those to the east and the north, each times a factor. Divided by the square of the
    distance between positions it is a straight line in the share of the east; the medians of the lower and the upper half are two
    points of that line.
    """
    if spans is None:
        return None
    square_m2 = spans.east_m**2 + spans.north_m**2
    share, ratio = spans.east_m**2 / square_m2, spans.distance_m**2 / square_m2
    low, high = np.percentile(share, [2.0, 98.0])
    upper = share > 0.5 * (low + high)
    if min(upper.sum(), (~upper).sum()) < _LEAST_SPANS:
        return None
    (low, at_low), (high, at_high) = ((float(np.median(share[half])), float(np.median(ratio[half]))) for half in (~upper, upper))
    if high - low < _LEAST_TURN:
        return None
    slope = (at_high - at_low) / (high - low)
    to_north, to_east = at_low - slope * low, at_low + slope * (1.0 - low)
    return float(np.sqrt(to_east / to_north)) if to_east > 0 and to_north > 0 else None


@dataclass(frozen=True)
class _Spans:
    """Straight stretches of some rows: distance by the file, and to the east and to the north by the positions, m."""

    distance_m: Array
    east_m: Array
    north_m: Array


def _straight(raw: Raw, places_m: tuple[Array, Array], distance_m: Array, time_s: Array) -> _Spans | None:
    """Stretches without a pause, long enough for places that are rounded or held for some rows; None where too few tell."""
    usual_m = float(np.median(distance_m[distance_m > 0])) if (distance_m > 0).any() else 0.0
    if not 0.0 < usual_m < np.inf:
        return None
    apart_m = np.hypot(*(np.diff(one) for one in places_m))
    moved_m = float(np.median(apart_m[apart_m > LEAST_M])) if (apart_m > LEAST_M).any() else usual_m
    long = int(np.clip(round(_SPAN_M / min(usual_m, moved_m)), 2, _MOST_ROWS))
    found = []
    for rows in _orders(raw, time_s):
        if len(rows) <= long:
            continue
        x, y, step_s = places_m[0][rows], places_m[1][rows], np.diff(time_s[rows], prepend=np.nan)
        driven_m, pauses = np.cumsum(np.nan_to_num(distance_m[rows])), np.cumsum(~(step_s <= 3.0 * np.nanmedian(step_s)))
        first = np.arange(0, len(rows) - long, max(1, long // 4))
        middle, last = first + long // 2, first + long
        east, north, distance = x[last] - x[first], y[last] - y[first], driven_m[last] - driven_m[first]
        halves = sum(np.hypot(x[b] - x[a], y[b] - y[a]) for a, b in ((first, middle), (middle, last)))
        with np.errstate(invalid="ignore"):
            straight = (
                (np.hypot(east, north) >= np.maximum(_STRAIGHT * halves, LEAST_M))
                & (distance > 0)
                & (pauses[last] == pauses[first])
            )
        found.append((distance[straight], east[straight], north[straight]))
    if sum(len(one[0]) for one in found) < _LEAST_SPANS:
        return None
    return _Spans(*(np.concatenate(one) for one in zip(*found, strict=True)))


def _orders(raw: Raw, time_s: Array) -> list[NDArray[np.intp]]:
    """The rows of each machine by time."""
    order = by_time(time_s, raw.machine_of_row)
    return np.split(order, np.flatnonzero(np.diff(raw.machine_of_row[order])) + 1)


def _plane(values: dict[str, Array]) -> tuple[Array, Array]:
    """Places on a plane, m; NaN where not known."""
    places, _ = plausible({"longitude_deg": values["longitude"], "latitude_deg": values["latitude"]})
    longitude, latitude = places["longitude_deg"], places["latitude_deg"]
    return places_m(longitude, latitude)


def _steps(raw: Raw, time_s: Array) -> Array:
    """Time from the row before of the same machine, s."""
    step_s = np.full(raw.count, np.nan)
    for rows in _orders(raw, time_s):
        step_s[rows[1:]] = np.diff(time_s[rows])
    return step_s


def each_of_a_sum(raw: Raw, total: Array, time_s: Array) -> Array | None:
    """Differences of a quantity that never falls, between rows of one machine; None for any other."""
    each = np.full(raw.count, np.nan)
    rising = moving = 0
    for rows in _orders(raw, time_s):
        steps = np.diff(total[rows])
        each[rows[1:]] = np.where(steps >= 0, steps, np.nan)
        each[rows[:1]] = each[rows[1:2]] if len(rows) > 1 else 0.0
        rising += int((steps >= 0).sum())
        moving += int((steps > 0).sum())
    count = raw.count - len(_orders(raw, time_s))
    return each if count >= _LEAST_ROWS and rising >= _RISING * count and moving >= 0.5 * count else None
