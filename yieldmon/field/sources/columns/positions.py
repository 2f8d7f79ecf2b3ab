"""Positions and numbers that no harvest has, taken as not known and said so."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from yieldmon.field.table import Array

HIGHEST_DEG = 85.0
"""Latitude beyond which there is no field."""

#: Column -> lowest and highest value that is taken as one.
LIMITS: Mapping[str, tuple[float, float]] = {
    "longitude_deg": (-180.0, 180.0),
    "latitude_deg": (-HIGHEST_DEG, HIGHEST_DEG),
    # Forage harvesters reach 100; a raw value that means "none" is often far above.
    "flow_kg_s": (0.0, 300.0),
    # A sensor that has nothing in it yet reads 0.
    "moisture_pct": (0.1, 100.0),
    "interval_s": (0.0, 3600.0),
    "distance_m": (0.0, 10_000.0),
    "width_m": (0.0, 100.0),
    "flow_sd_kg_s": (0.0, 1000.0),
    "position_sd_m": (0.0, 1000.0),
    "time_s": (-1e11, 1e11),
    "elevation_m": (-1000.0, 10_000.0),
}

_LEAST_MARKS, _MOST_MARKED = 10, 0.2
"""Rows with one value, and their share of all, that may be a mark for "not known"."""
_FAR, _LEAST_OTHERS = 5.0, 100
"""Times nearly all other values that a mark is, and how many others tell."""


def without_marks(values: Array, name: str) -> tuple[Array, tuple[str, ...]]:
    """Values without a largest one that many rows have and that is far above all others; and a note on it.

    Parameters
    ----------
    values : array, shape (n,)
        NaN where not known.
    name : str
        Of the column.

    Examples
    --------
    >>> without_marks(np.r_[np.linspace(1.0, 9.0, 500), np.full(20, 99.9)], "yield")[1]
    ('yield: 20 rows have one value, 11.1 times that of nearly all others: it is taken as unknown',)
    """
    known = values[np.isfinite(values) & (values > 0)]
    if not known.size:
        return values, ()
    largest = float(known.max())
    others = known[known < largest]
    count = known.size - others.size
    if count < _LEAST_MARKS or count > _MOST_MARKED * known.size or others.size < _LEAST_OTHERS:
        return values, ()
    usual = float(np.percentile(others, 99.5))
    if largest < _FAR * usual:
        return values, ()
    note = f"{name}: {count} rows have one value, {largest / usual:.3g} times that of nearly all others: it is taken as unknown"
    return np.where(values == largest, np.nan, values), (note,)


def on_the_globe(longitude_deg: Array, latitude_deg: Array) -> tuple[Array, Array, tuple[str, ...]]:
    """Longitudes from 0 to 360 as those from -180 to 180, and both where they can only be exchanged; and a note on that.

    Examples
    --------
    >>> on_the_globe(np.full(3, 42.0), np.full(3, -93.0))[:2]
    (array([-93., -93., -93.]), array([42., 42., 42.]))
    >>> on_the_globe(np.array([266.8, 266.9]), np.array([42.0, 42.0]))[0].round(3).tolist()
    [-93.2, -93.1]
    """
    notes: tuple[str, ...] = ()
    known = np.isfinite(longitude_deg) & np.isfinite(latitude_deg)
    with np.errstate(invalid="ignore"):
        exchanged = known & (np.abs(latitude_deg) > 90) & (np.abs(latitude_deg) <= 180) & (np.abs(longitude_deg) <= 90)
        if 2 * exchanged.sum() > known.sum():
            longitude_deg, latitude_deg = latitude_deg, longitude_deg
            notes = ("latitudes lie beyond 90 degrees: longitude and latitude are exchanged",)
        east = known & (longitude_deg > 180) & (longitude_deg <= 360) & (np.abs(latitude_deg) <= 90)
        # A value that means "none" is one and the same.
        if 10 * east.sum() > known.sum() and np.ptp(longitude_deg[east]) > 0:
            longitude_deg = np.where(east, longitude_deg - 360.0, longitude_deg)
    return longitude_deg, latitude_deg, notes


def plausible(columns: Mapping[str, Array]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """The columns with impossible values unknown, and a note on each column that had some. (0, 0) is a receiver without a fix."""
    out, notes = {}, []
    for name, given in columns.items():
        values = np.asarray(given, float)
        low, high = LIMITS.get(name, (-np.inf, np.inf))
        with np.errstate(invalid="ignore"):
            wrong = np.isinf(values) | (values < low) | (values > high)
        if wrong.any():
            notes.append(f"{int(wrong.sum())} values of {name} outside {low:g} to {high:g} are taken as unknown")
            values = np.where(wrong, np.nan, values)
        out[name] = values
    no_fix = (out["longitude_deg"] == 0) & (out["latitude_deg"] == 0)
    if no_fix.any():
        notes.append(f"{int(no_fix.sum())} positions at 0, 0 are taken as unknown")
    lost = no_fix | np.isnan(out["longitude_deg"]) | np.isnan(out["latitude_deg"])
    out["longitude_deg"], out["latitude_deg"] = (np.where(lost, np.nan, out[n]) for n in ("longitude_deg", "latitude_deg"))
    return out, tuple(notes)
