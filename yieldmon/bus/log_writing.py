"""Writing logs of every format that python-can writes, to the last frame."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can

_POLL_S = 0.01


@contextmanager
def writing(path: Path | str) -> Iterator[can.Listener]:
    """A listener that writes what it is given to the log, whose format its name's ending says.

    Raises ValueError for an ending that python-can does not know, OSError for a file that cannot be written.
    """
    with can.Logger(path) as logger:
        yield logger
        if isinstance(logger, can.SqliteWriter):
            # It writes on a thread of its own, which forgets what is still in the queue when it is stopped.
            while not logger.buffer.empty():
                time.sleep(_POLL_S)
