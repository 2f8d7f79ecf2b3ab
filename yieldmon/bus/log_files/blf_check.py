"""Where a .blf log is damaged, known before python-can reads it: it takes what comes out of a damaged container for frames, and
never gets past an object that says it has no length."""

from __future__ import annotations

import zlib
from pathlib import Path

from can.io.blf import (
    FILE_HEADER_STRUCT,
    LOG_CONTAINER,
    LOG_CONTAINER_STRUCT,
    NO_COMPRESSION,
    OBJ_HEADER_BASE_STRUCT,
    OBJ_HEADER_V1_STRUCT,
    ZLIB_DEFLATE,
)

_SIGNATURE = b"LOBJ"
#: Vector writes containers of 128 kB.
_LARGEST_CONTAINER_BYTES = 16 * 1024 * 1024
_LARGEST_OBJECT_BYTES = 2 * _LARGEST_CONTAINER_BYTES
#: Of an object within a container, with the second part of its header.
_SMALLEST_OBJECT_BYTES = OBJ_HEADER_BASE_STRUCT.size + OBJ_HEADER_V1_STRUCT.size
#: An object begins within so many bytes after the one before.
_PADDING_BYTES = 8


def first_flaw(path: Path) -> tuple[int, str] | None:
    """Byte at which the first damaged object of the file begins and what is wrong with it; None for a sound file."""
    objects = _Objects()
    with path.open("rb") as stream:
        header = FILE_HEADER_STRUCT.unpack(stream.read(FILE_HEADER_STRUCT.size))
        stream.seek(header[1])
        while True:
            start = stream.tell()
            base = stream.read(OBJ_HEADER_BASE_STRUCT.size)
            if not base:
                return None
            if len(base) < OBJ_HEADER_BASE_STRUCT.size:
                return start, "the file ends within an object"
            signature, _, _, size, kind = OBJ_HEADER_BASE_STRUCT.unpack(base)
            if signature != _SIGNATURE or size < len(base):
                return start, "no object begins here"
            if size > _LARGEST_OBJECT_BYTES:
                return start, f"an object of {size} bytes"
            body = stream.read(size - len(base))
            if len(body) < size - len(base):
                return start, f"the file ends within an object of {size} bytes"
            problem = objects.problem(body) if kind == LOG_CONTAINER else None
            if problem is not None:
                return start, problem
            stream.read(size % 4)


class _Objects:
    """The objects in a file's containers, one of which may begin in one container and end in the next."""

    def __init__(self) -> None:
        self._rest = b""

    def problem(self, container: bytes) -> str | None:
        """What is wrong with the next container, or with an object that ends in it."""
        method = LOG_CONTAINER_STRUCT.unpack_from(container)[0]
        content = container[LOG_CONTAINER_STRUCT.size :]
        if method == ZLIB_DEFLATE:
            inflating = zlib.decompressobj()
            try:
                content = inflating.decompress(content, _LARGEST_CONTAINER_BYTES)
            except zlib.error as error:
                return f"compressed container damaged: {error}"
            if not inflating.eof:
                return "compressed container damaged: it ends early or unpacks to too much"
        elif method != NO_COMPRESSION:
            # python-can passes over it.
            return None
        return self._too_short(self._rest + content)

    def _too_short(self, content: bytes) -> str | None:
        at = 0
        while True:
            begin = content.find(_SIGNATURE, at, at + _PADDING_BYTES)
            if begin < 0 or begin + OBJ_HEADER_BASE_STRUCT.size > len(content):
                break
            size = OBJ_HEADER_BASE_STRUCT.unpack_from(content, begin)[3]
            if size < _SMALLEST_OBJECT_BYTES:
                return f"an object of {size} bytes"
            if begin + size > len(content):
                break
            at = begin + size
        self._rest = content[at:]
        return None
