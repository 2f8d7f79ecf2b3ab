"""Background tiles for the map from one local MBTiles file (https://github.com/mapbox/mbtiles-spec, version 1.3)."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from yieldmon.bounded import why_no_file
from yieldmon.bounded_sqlite import address, bound, reading
from yieldmon.errors import InputError

_KINDS = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}
_LARGEST_TILE_BYTES = 4 * 1024 * 1024
_LARGEST_ZOOM = 22
#: Processor time that a look may take, s: `tiles` may be a view, which can be written so that it never ends.
_LOOK_S, _FIRST_LOOK_S = 1.0, 20.0


class Tiles:
    """Pictures of 256 by 256 pixels by zoom, column and row, rows counted from the north."""

    def __init__(self, path: Path) -> None:
        """Raises InputError when the file is no MBTiles file with pictures in it."""
        self._path = path
        expected = "an MBTiles file with PNG, JPEG or WebP tiles"
        if not path.is_file():
            raise InputError(str(path), why_no_file(path), expected)
        try:
            with reading(), closing(self._opened(_FIRST_LOOK_S)) as database:
                low, high = database.execute("SELECT min(zoom_level), max(zoom_level) FROM tiles").fetchone()
                sample = database.execute("SELECT tile_data FROM tiles LIMIT 1").fetchone()
                note = database.execute("SELECT value FROM metadata WHERE name = 'attribution'").fetchone()
        except sqlite3.Error as error:
            raise InputError(str(path), str(error), expected) from error
        if sample is None or _kind(sample[0]) is None or not isinstance(low, int) or not isinstance(high, int):
            raise InputError(str(path), "holds no pictures", expected)
        self.zooms = (max(0, low), min(high, _LARGEST_ZOOM))
        self.attribution = str(note[0])[:200] if note else ""

    def tile(self, zoom: int, column: int, row: int) -> tuple[bytes, str] | None:
        """A tile and its media type, None where there is none."""
        if not 0 <= zoom <= _LARGEST_ZOOM or not 0 <= row < 1 << zoom:
            return None
        try:
            with reading(), closing(self._opened(_LOOK_S)) as database:
                query = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
                found = database.execute(query, (zoom, column, (1 << zoom) - 1 - row)).fetchone()
        except (sqlite3.Error, OverflowError):
            return None
        kind = _kind(found[0]) if found else None
        return (found[0], kind) if kind else None

    def _opened(self, most_s: float) -> sqlite3.Connection:
        database = sqlite3.connect(address(self._path, "mode=ro&immutable=1"), uri=True)
        bound(database, largest_value_bytes=_LARGEST_TILE_BYTES, most_cpu_s=most_s)
        return database


def _kind(data: object) -> str | None:
    if not isinstance(data, bytes) or len(data) > _LARGEST_TILE_BYTES:
        return None
    return next((kind for begin, kind in _KINDS.items() if data.startswith(begin)), None)
