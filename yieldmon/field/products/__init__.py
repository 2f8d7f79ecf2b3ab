"""What a map is written as, a module a format: `write(folder, result, grid) -> the files it wrote`."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from yieldmon.field.grid import block_means
from yieldmon.files.whole_file import scratch_folder_for

if TYPE_CHECKING:
    from yieldmon.field.harvest import HarvestMap  # which needs the extra `map`

#: Name -> what it holds. The module of that name writes it; the report is last, for it names the others.
FORMATS = {
    "csv": "points with reasons",
    "geopackage": "points, swaths and grid",
    "shapefile": "points kept",
    "agleader": "text raw, for Yield Editor, and cleaned",
    "taskdata": "ISO 11783-10, as measured, with working width and lag",
    "geotiff": "grid of block means with standard error",
    "picture": "PNG map",
    "report": "one HTML file",
}

#: Name -> the files that it writes into its folder.
FILES = {
    "csv": ("points.csv",),
    "geopackage": ("harvest.gpkg",),
    "shapefile": ("points_shp.zip",),
    "agleader": ("agleader_raw.txt", "agleader_clean.txt"),
    "taskdata": ("taskdata.zip",),
    "geotiff": ("yield.tif",),
    "picture": ("map.png",),
    "report": ("report.html",),
}


def write_products(
    folder: Path, result: HarvestMap, formats: Sequence[str], grid_m: float, progress: Callable[[str], None]
) -> list[Path]:
    """Write the formats into a folder that exists, all or none, and return the files."""
    mass = result.placed.mass_kg
    grid = block_means(
        result.table["longitude_deg"], result.table["latitude_deg"], mass, result.ground.area_m2, result.cleaned.kept, grid_m
    )
    written: list[Path] = []
    if not formats:
        return written
    with scratch_folder_for(folder, [file for name in formats for file in FILES[name]]) as scratch:
        for name in FORMATS:
            if name in formats:
                coarser = (
                    ""
                    if name != "geotiff" or grid.fits()
                    else f", in blocks over {grid_m:g} m: the fields lie too far apart for these"
                )
                progress(f"writing {name}{coarser}")
                written += importlib.import_module(f"{__name__}.{name}").write(scratch, result, grid)
    return [folder / path.name for path in written]
