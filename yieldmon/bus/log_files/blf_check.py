"""Where a .blf log is damaged, known before python-can reads it: it takes what comes out of a damaged container for frames, and
never gets past an object that says it has no length."""

from __future__ import annotations

import struct
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
_MARKER, _MARKER_HEAD_BYTES = 96, 72
"""Kind of a marker that somebody set while recording, and what it has before its three texts."""
_MARKER_LACKS_BYTES = 24
"""That its stated size is too small, as Vector's programs write it."""
_MARKER_TEXTS = struct.Struct("<3L")
_MARKER_TEXTS_AT = 48


def size_of(content: bytes, begin: int) -> int:
    """Bytes of the object of a container that begins there, of a marker those that it has."""
    size, kind = map(int, OBJ_HEADER_BASE_STRUCT.unpack_from(content, begin)[3:])
    if kind != _MARKER or begin + _MARKER_TEXTS_AT + _MARKER_TEXTS.size > len(content):
        return size
    lacking = _MARKER_HEAD_BYTES + sum(_MARKER_TEXTS.unpack_from(content, begin + _MARKER_TEXTS_AT)) - size
    return size + (_MARKER_LACKS_BYTES if lacking == _MARKER_LACKS_BYTES else 0)


def marker_end(content: bytes, stated_end: int) -> int | None:
    """Where a marker ends that states this end; None for an object of another kind."""
    begin = content.rfind(_SIGNATURE, 0, stated_end)
    if begin < 0 or begin + OBJ_HEADER_BASE_STRUCT.size > len(content):
        return None
    if begin + OBJ_HEADER_BASE_STRUCT.unpack_from(content, begin)[3] != stated_end:
        return None
    end = begin + size_of(content, begin)
    return end if end > stated_end else None


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
        self._rest: bytes | None = b""

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
        return None if self._rest is None else self._too_short(self._rest + content)

    def _too_short(self, content: bytes) -> str | None:
        at = 0
        while True:
            begin = content.find(_SIGNATURE, at, at + _PADDING_BYTES)
            if begin < 0 and at + _PADDING_BYTES <= len(content):
                # The reader finds none either, and says so.
                self._rest = None
                return None
            if begin < 0 or begin + OBJ_HEADER_BASE_STRUCT.size > len(content):
                break
            size = size_of(content, begin)
            if size < _SMALLEST_OBJECT_BYTES:
                return f"an object of {size} bytes"
            if begin + size > len(content):
                break
            at = begin + size
        self._rest = content[at:]
        return None
