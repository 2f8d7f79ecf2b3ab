"""The points kept as a zipped shapefile, with names of ten letters."""

from __future__ import annotations

import tempfile
import zipfile
from pathlib import Path

import numpy as np

from yieldmon.field.grid import Grid
from yieldmon.field.harvest import HarvestMap
from yieldmon.files.whole_file import scratch_for

from . import FILES, vectors
from .columns import SHORT_NAMES, point_columns


def write(folder: Path, result: HarvestMap, grid: Grid) -> list[Path]:
    """`points_shp.zip`; times as text, for a shapefile knows dates only."""
    path = folder / FILES["shapefile"][0]
    kept = np.flatnonzero(result.cleaned.kept)
    if not len(kept):
        return []
    with tempfile.TemporaryDirectory() as place:
        target = Path(place) / "points.shp"
        for first in range(0, len(kept), vectors.CHUNK):
            rows = kept[first : first + vectors.CHUNK]
            columns = {SHORT_NAMES[name]: values for name, values in point_columns(result, rows).items() if name in SHORT_NAMES}
            if "TIMEUTC" in columns:
                columns["TIMEUTC"] = np.char.add(np.datetime_as_string(columns["TIMEUTC"], unit="ms"), "Z").astype(object)
            shapes = vectors.points(result.table["longitude_deg"][rows], result.table["latitude_deg"][rows])
            vectors.write_layer(target, "points", "ESRI Shapefile", "Point", shapes, columns, append=first > 0)
        with scratch_for(path) as scratch, zipfile.ZipFile(scratch, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for part in sorted(Path(place).iterdir()):
                archive.write(part, part.name)
    return [path]
