"""One GeoPackage: layer `points` (all, with reasons), `swaths` (the ground newly cut by each), `grid` (block means)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely

from yieldmon.field.grid import Grid
from yieldmon.field.harvest import HarvestMap
from yieldmon.files.whole_file import scratch_for
from yieldmon.units import T_HA_PER_KG_M2

from . import FILES, vectors
from .columns import point_columns

_SWATH_COLUMNS = ("point", "mass_kg", "area_m2", "gross_area_m2", "yield_t_ha", "time_utc", "kept")
"""The other columns of a swath are those of its point."""


def write(folder: Path, result: HarvestMap, grid: Grid) -> list[Path]:
    """`harvest.gpkg`."""
    path = folder / FILES["geopackage"][0]
    count = len(result.table)
    with scratch_for(path) as scratch:
        for first in range(0, count, vectors.CHUNK):
            rows = np.arange(first, min(first + vectors.CHUNK, count))
            columns = point_columns(result, rows)
            places = vectors.points(result.table["longitude_deg"][rows], result.table["latitude_deg"][rows])
            vectors.write_layer(scratch, "points", "GPKG", "Point", places, columns, append=first > 0)
        started = False
        for first in range(0, count, vectors.CHUNK):
            rows = np.arange(first, min(first + vectors.CHUNK, count))
            rows = rows[result.ground.area_m2[rows] > 0]
            if len(rows):
                columns = point_columns(result, rows)
                chosen = {name: columns[name] for name in _SWATH_COLUMNS if name in columns}
                vectors.write_layer(
                    scratch, "swaths", "GPKG", "MultiPolygon", vectors.ground(result, rows), chosen, append=started
                )
                started = True
        if len(grid.row):
            _write_grid(scratch, grid)
    return [path]


def _write_grid(path: Path, grid: Grid) -> None:
    west = grid.west_deg + grid.column * grid.width_deg
    north = grid.north_deg - grid.row * grid.height_deg
    blocks = shapely.multipolygons(
        shapely.box(west, north - grid.height_deg, west + grid.width_deg, north), indices=np.arange(len(west))
    )
    columns = {
        "yield_t_ha": grid.yield_kg_m2 * T_HA_PER_KG_M2,
        "standard_error_t_ha": grid.standard_error_kg_m2 * T_HA_PER_KG_M2,
        "points": grid.points,
        "left_out_share": grid.left_out,
    }
    vectors.write_layer(path, "grid", "GPKG", "MultiPolygon", vectors.parted(blocks), columns, append=False)
