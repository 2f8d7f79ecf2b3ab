"""The grid as a GeoTIFF of two bands, yield and its standard error in t/ha, WGS 84; blocks without points are NaN.

Sources: TIFF 6.0 (Adobe, 1992); OGC 19-008, GeoTIFF 1.1; GDAL's GeoTIFF driver, for names and units of bands.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from yieldmon.field.grid import Grid, block_means
from yieldmon.field.harvest import HarvestMap
from yieldmon.files import whole_file
from yieldmon.units import T_HA_PER_KG_M2

from . import FILES

_SHORT, _LONG, _DOUBLE, _ASCII = 3, 4, 12, 2
_FORMATS = {_SHORT: "H", _LONG: "I", _DOUBLE: "d"}
ROWS_PER_STRIP = 64
_BANDS = ("yield_t_ha", "standard_error_t_ha")
_UNIT = "t/ha"


def write(folder: Path, result: HarvestMap, grid: Grid) -> list[Path]:
    """`yield.tif`."""
    if not len(grid.row):
        return []
    path = folder / FILES["geotiff"][0]
    table = result.table
    while not grid.fits():
        # A raster of fields far apart would be too large: coarser blocks.
        grid = block_means(
            table["longitude_deg"],
            table["latitude_deg"],
            result.placed.mass_kg,
            result.ground.area_m2,
            result.cleaned.kept,
            2.0 * grid.size_m,
        )
    bands = np.stack([grid.raster(grid.yield_kg_m2), grid.raster(grid.standard_error_kg_m2)], axis=-1) * T_HA_PER_KG_M2
    whole_file.write(path, tiff(bands.astype("<f4"), grid))
    return [path]


def _metadata() -> str:
    """Names and units of the bands, as GDAL reads them."""
    items = [
        f'<Item name="{name}" sample="{band}" role="{role}">{value}</Item>'
        for band, title in enumerate(_BANDS)
        for name, role, value in (("DESCRIPTION", "description", title), ("UNITTYPE", "unittype", _UNIT))
    ]
    return f"<GDALMetadata>{''.join(items)}</GDALMetadata>"


def tiff(bands: np.ndarray, grid: Grid) -> bytes:
    """bands: shape (rows, columns, bands), float32."""
    rows, columns, depth = bands.shape
    strips = [zlib.compress(bands[first : first + ROWS_PER_STRIP].tobytes(), 6) for first in range(0, rows, ROWS_PER_STRIP)]
    tags: dict[int, tuple[int, list[float] | str]] = {
        256: (_LONG, [columns]),
        257: (_LONG, [rows]),
        258: (_SHORT, [32] * depth),
        259: (_SHORT, [8]),
        262: (_SHORT, [1]),
        270: (_ASCII, ", ".join(_BANDS)),
        277: (_SHORT, [depth]),
        278: (_LONG, [ROWS_PER_STRIP]),
        284: (_SHORT, [1]),
        338: (_SHORT, [0] * (depth - 1)),
        339: (_SHORT, [3] * depth),
        279: (_LONG, [len(strip) for strip in strips]),
        33550: (_DOUBLE, [grid.width_deg, grid.height_deg, 0.0]),
        33922: (_DOUBLE, [0.0, 0.0, 0.0, grid.west_deg, grid.north_deg, 0.0]),
        34735: (_SHORT, [1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326]),
        42112: (_ASCII, _metadata()),
        42113: (_ASCII, "nan"),
    }
    offsets, at = [], 8
    for strip in strips:
        offsets.append(at)
        at += len(strip) + len(strip) % 2
    tags[273] = (_LONG, [float(one) for one in offsets])
    body = b"".join(strip + b"\0" * (len(strip) % 2) for strip in strips)
    directory, extra = [], b""
    data_at = at + 2 + 12 * len(tags) + 4
    for tag in sorted(tags):
        kind, value = tags[tag]
        if isinstance(value, str):
            packed, count = value.encode() + b"\0", len(value) + 1
        else:
            packed = struct.pack(f"<{len(value)}{_FORMATS[kind]}", *(value if kind == _DOUBLE else map(int, value)))
            count = len(value)
        if len(packed) <= 4:
            directory.append(struct.pack("<HHI", tag, kind, count) + packed.ljust(4, b"\0"))
        else:
            directory.append(struct.pack("<HHII", tag, kind, count, data_at + len(extra)))
            extra += packed + b"\0" * (len(packed) % 2)
    head = struct.pack("<2sHI", b"II", 42, at)
    return head + body + struct.pack("<H", len(tags)) + b"".join(directory) + struct.pack("<I", 0) + extra
