"""Writing logs of every format that python-can writes, to the last frame."""

from __future__ import annotations

import errno
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can

from yieldmon.bus import mf4

_POLL_S = 0.01
_NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""A write's error does not name its file."""


@contextmanager
def writing(path: Path | str) -> Iterator[can.Listener]:
    """A listener that writes what it is given to the log, whose format its name's ending says.

    Raises ValueError for an ending that python-can does not know, OSError, which names the file, where it cannot be written.
    """
    if ".mf4" in Path(path).suffixes:
        mf4.provide()
    try:
        with can.Logger(path) as logger:
            yield logger
            if isinstance(logger, can.SqliteWriter):
                _wait_until_taken(logger, path)
    except OSError as error:
        if error.filename is None and error.errno in _NO_ROOM:
            error.filename = str(path)
        raise


def _wait_until_taken(logger: can.SqliteWriter, path: Path | str) -> None:
    """It writes on a thread of its own, which forgets what is still in the queue when it is stopped."""
    while not logger.buffer.empty():
        if not logger._writer_thread.is_alive():
            raise OSError(errno.EIO, "not all frames could be written", str(path))
        time.sleep(_POLL_S)
