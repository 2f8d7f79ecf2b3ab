"""Yield points as an OGC GeoPackage, by GDAL through pyogrio (the `geo` extra)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from yieldmon.files.whole_file import library_failures, scratch_for

from .geojson import properties
from .points import YieldPoint

LAYER = "yield"


def write(path: Path, points: Sequence[YieldPoint]) -> None:
    """One layer of points in EPSG:4326. Needs pyogrio. Raises OSError."""
    import pyogrio.errors
    import pyogrio.raw

    rows = [properties(point) for point in points]
    names = list(rows[0]) if rows else []
    columns = [_column([row[name] for row in rows]) for name in names]
    # Well-known binary: little-endian, type 1 (point), x, y.
    places = [struct.pack("<BIdd", 1, 1, point.longitude_deg, point.latitude_deg) for point in points]
    kinds = pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError
    with scratch_for(path) as scratch, library_failures(scratch, *kinds):
        pyogrio.raw.write(
            str(scratch),
            geometry=np.array(places, dtype=object),
            field_data=columns,
            fields=np.array(names, dtype=object),
            geometry_type="Point",
            crs="EPSG:4326",
            driver="GPKG",
            layer=LAYER,
        )


def _column(values: list[object]) -> np.ndarray:
    if any(isinstance(value, str) for value in values):
        return np.array(values, dtype=object)
    if all(isinstance(value, bool) for value in values):
        return np.array(values, dtype=bool)
    if all(isinstance(value, int) for value in values):
        return np.array(values, dtype=np.int64)
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
