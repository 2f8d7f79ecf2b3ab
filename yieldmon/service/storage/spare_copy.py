"""A store that cannot be put in order where it lies: its medium takes no writing, has no room, or does not read all of it.

What is left of it is read from a copy on another medium. The store itself stays as it is.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

from yieldmon.service.storage.store_errors import StoreError, StoreUnreadableError
from yieldmon.service.storage.store_file import LARGEST_COPY_BYTES
from yieldmon.service.storage.store_names import parts

#: Where a copy may lie, in this order; None: the system's folder for temporary files.
_PLACES: tuple[str | None, ...] = (None, "/dev/shm")
_PIECE_BYTES, _SECTOR_BYTES = 1 << 20, 512
#: A medium that fails may try for seconds before it gives up a sector.
_READING_S = 20.0


@contextmanager
def spare_copy(path: Path) -> Iterator[tuple[Path, int]]:
    """A copy of the store at `path` and of its journal, and how many bytes of them could not be read and are zero there.

    Raises StoreUnreadableError where nothing of it can be read, StoreError where there is no room for it.
    """
    failures: list[str] = []
    for place in _PLACES:
        try:
            folder = TemporaryDirectory(prefix="yieldmon-", dir=place, ignore_cleanup_errors=True)
        except OSError as error:
            failures.append(str(error))
            continue
        with folder as name:
            try:
                unread = _copy(path, Path(name))
            except OSError as error:
                failures.append(str(error))
                continue
            yield Path(name) / path.name, unread
            return
    raise StoreError(f"{path}: cannot be copied to be read: {'; '.join(dict.fromkeys(failures))}")


def _copy(path: Path, folder: Path) -> int:
    """Raises OSError, StoreError."""
    end_s, size, unread = monotonic() + _READING_S, 0, 0
    for part in parts(path)[:2]:
        try:
            source = os.open(part, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except FileNotFoundError:
            continue
        try:
            length = os.fstat(source).st_size
            size += length
            if size > LARGEST_COPY_BYTES:
                raise StoreError(f"{path}: {size >> 20} MB, too large to be copied; expected at most {LARGEST_COPY_BYTES >> 20}")
            with (folder / part.name).open("xb") as target:
                for begin in range(0, length, _PIECE_BYTES):
                    piece, missing = _read(source, begin, min(_PIECE_BYTES, length - begin), end_s)
                    target.write(piece)
                    unread += missing
        finally:
            os.close(source)
    if size and unread == size:
        raise StoreUnreadableError(f"{path}: nothing of it can be read")
    return unread


def _read(source: int, begin: int, length: int, end_s: float) -> tuple[bytes, int]:
    """So many bytes, and how many of them could not be read and are zero."""
    try:
        if monotonic() > end_s:
            return bytes(length), length
        return os.pread(source, length, begin).ljust(length, b"\0"), 0
    except OSError as error:
        if error.errno != errno.EIO:
            raise
    if length <= _SECTOR_BYTES:
        return bytes(length), length
    # The medium's sectors are read one by one only where one of them fails.
    half = -(-length // 2 // _SECTOR_BYTES) * _SECTOR_BYTES
    first, missing = _read(source, begin, half, end_s)
    second, more = _read(source, begin + half, length - half, end_s)
    return first + second, missing + more
