"""Decompressing a log that may be damaged: everything before the damage comes out, then the stream ends and says why.

The gzip module raises in the middle of a read and keeps what it had decompressed to itself.
"""

from __future__ import annotations

import io
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, cast

from yieldmon.bounded import opened

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

#: Compressed bytes taken at a time, so at most the frames of this much are lost before a damaged place.
_STEP_BYTES = 16 * 1024
_GZIP = 31
_MAGIC = b"\x1f\x8b"


class Gunzip(io.RawIOBase):
    """Readable stream of a gzip file's content. `problem`: why it ended early, None while all is well."""

    def __init__(self, path: Path) -> None:
        """Raises OSError when the file cannot be opened."""
        super().__init__()
        self.problem: str | None = None
        self._file = opened(path)
        self._member = zlib.decompressobj(_GZIP)
        self._ready = memoryview(b"")
        self._ended = False

    def readable(self) -> bool:
        return True

    def readinto(self, target: WriteableBuffer) -> int:
        while not self._ready and not self._ended:
            self._ready = memoryview(self._next_piece())
        view = memoryview(target).cast("B")
        count = min(len(view), len(self._ready))
        view[:count] = self._ready[:count]
        self._ready = self._ready[count:]
        return count

    def close(self) -> None:
        # Python closes one as well whose file could not be opened.
        if hasattr(self, "_file"):
            self._file.close()
        super().close()

    def _next_piece(self) -> bytes:
        packed = self._member.unused_data.lstrip(b"\0") if self._member.eof else b""
        packed += self._file.read(_STEP_BYTES)
        if self._member.eof:
            packed = packed.lstrip(b"\0")
            if packed and not packed.startswith(_MAGIC):
                self._end("no compressed data follow")
            elif packed:
                self._member = zlib.decompressobj(_GZIP)
        if not packed:
            self._end(None if self._member.eof else "the compressed data end early")
        if self._ended:
            return b""
        try:
            return self._member.decompress(packed)
        except zlib.error as error:
            self._end(f"compressed data damaged: {error}")
            return b""

    def _end(self, problem: str | None) -> None:
        self._ended = True
        if problem is not None:
            self.problem = f"{problem} (compressed byte {self._file.tell()})"


def open_bytes(path: Path, compressed: bool) -> io.BufferedReader:
    """The log's bytes, decompressed; early_end_of() says at their end whether they are all."""
    return io.BufferedReader(Gunzip(path)) if compressed else cast("io.BufferedReader", opened(path))


def early_end_of(stream: io.BufferedReader) -> str | None:
    """Why a stream of open_bytes() ended before its time, None where it did not."""
    return stream.raw.problem if isinstance(stream.raw, Gunzip) else None
