"""Vector's .blf by python-can, also behind a marker, which is longer than it says: python-can finds no object there."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import can
from can.io.blf import BLFParseError

from yieldmon.bus.log_files.blf_check import marker_end


class Blf(can.BLFReader):
    """Iterable of the frames; `stop` closes the file."""

    _owed = 0
    """Bytes of a marker that the next container begins with."""

    def _parse_data(self, data: bytes) -> Iterator[can.Message]:
        start, self._owed = self._owed, 0
        while start < len(data):
            failed: Exception | None = None
            try:
                yield from super()._parse_data(data[start:])
            except (BLFParseError, struct.error) as error:
                failed = error
            stated_end = start + self._pos
            end = marker_end(data, stated_end)
            if end is None:
                self._pos = stated_end
                if failed is not None:
                    raise failed
                return
            start = end
        self._owed, self._pos = start - len(data), len(data)
