"""What reading a damaged zip raises, and which names in a zip or folder may be those of harvests."""

from __future__ import annotations

import struct
import zipfile
import zlib

ZIP_DAMAGE = (
    OSError,
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,  # a compression that is not known
    RuntimeError,  # a member that is encrypted
    UnicodeError,  # names that are not what their flag says
    struct.error,
    OverflowError,
)

_SUFFIXES = (
    ".txt", ".csv", ".tsv", ".dat", ".shp", ".gpkg", ".geojson", ".geojsonl", ".geojsons", ".gml", ".fgb", ".kml", ".sqlite",
    ".zip", ".xlsx", ".parquet",
)  # fmt: skip


def may_be_harvest(name: str) -> bool:
    """By the suffix; task data apart."""
    return name.lower().endswith(_SUFFIXES) and not name.rsplit("/", 1)[-1].startswith("._")
