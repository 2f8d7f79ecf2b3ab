"""Points, swaths and blocks through GDAL (pyogrio, the `map` extra), in pieces so that memory stays bounded."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from yieldmon.field.harvest import HarvestMap
from yieldmon.field.plane import Sites
from yieldmon.field.table import Array, Index
from yieldmon.files.whole_file import library_failures

CHUNK = 100_000
Shapes = NDArray[np.object_]


def write_layer(
    path: Path, layer: str, driver: str, kind: str, shapes: Shapes, columns: Mapping[str, NDArray[Any]], *, append: bool
) -> None:
    """Add features to a layer; `append` false makes it. Raises OSError."""
    import pyogrio.errors
    import pyogrio.raw

    failures = library_failures(path, pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError)
    with failures, warnings.catch_warnings():
        # A shapefile cuts long names and wide numbers; the names given are short and the numbers are rounded.
        warnings.simplefilter("ignore", RuntimeWarning)
        pyogrio.raw.write(
            str(path),
            geometry=shapely.to_wkb(shapes),
            field_data=[_plain(values) for values in columns.values()],
            fields=np.array(list(columns), dtype=object),
            geometry_type=kind,
            crs="EPSG:4326",
            driver=driver,
            layer=layer,
            append=append,
        )


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    if values.dtype == np.int64:
        return values.astype(np.int32)
    return values


def points(longitude_deg: Array, latitude_deg: Array) -> Shapes:
    """Points; empty ones where the position is not known."""
    known = np.isfinite(longitude_deg) & np.isfinite(latitude_deg)
    shapes = np.full(len(longitude_deg), shapely.Point(), dtype=object)
    shapes[known] = shapely.points(longitude_deg[known], latitude_deg[known])
    return shapes


def ground(result: HarvestMap, rows: Index) -> Shapes:
    """New ground of some rows as multi-polygons in degrees."""
    shapes = result.ground.polygons(rows)
    return in_degrees(shapes, result.steps.plane)


def in_degrees(shapes: Shapes, plane: Sites) -> Shapes:
    """Shapes of the plane in longitude and latitude, all as multi-polygons."""
    out: Shapes = shapely.transform(shapes, lambda places: np.column_stack(plane.to_deg(places[:, 0], places[:, 1])))
    single = shapely.get_type_id(out) == 3
    if single.any():
        index = np.cumsum(single) - 1
        out[single] = shapely.multipolygons(out[single], indices=index[single])
    other = ~np.isin(shapely.get_type_id(out), (3, 6))
    out[other] = [_areas(shape) for shape in out[other]]
    return parted(out)


def parted(shapes: Shapes) -> Shapes:
    """Areas in degrees, with those across the 180th meridian as a part on either side of it.

    Examples
    --------
    >>> [part.bounds[::2] for part in parted(np.array([shapely.box(179.5, 0.0, 180.5, 1.0)]))[0].geoms]
    [(179.5, 180.0), (-180.0, -179.5)]
    """
    west, _, east, _ = np.moveaxis(shapely.bounds(shapes), -1, 0)
    with np.errstate(invalid="ignore"):
        across = (east - west > 180.0) | (east > 180.0) | (west < -180.0)
    out = shapes.copy()
    for place in np.flatnonzero(across):
        whole = shapely.transform(shapes[place], lambda places: np.column_stack((places[:, 0] % 360.0, places[:, 1])))
        east_of, west_of = (shapely.intersection(whole, shapely.box(first, -90.0, first + 180.0, 90.0)) for first in (0.0, 180.0))
        west_of = shapely.transform(west_of, lambda places: places - (360.0, 0.0))
        out[place] = shapely.MultiPolygon([*_areas(east_of).geoms, *_areas(west_of).geoms])
    return out


def _areas(shape: shapely.Geometry) -> shapely.MultiPolygon:
    parts = [part for part in shapely.get_parts(shape) if part.geom_type == "Polygon"]
    return shapely.MultiPolygon(parts)
