"""Writing logs of every format that python-can writes, to the last frame."""

from __future__ import annotations

import errno
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can

from yieldmon.bus.log_files import mf4
from yieldmon.errors import NO_ROOM, database_errno

_POLL_S = 0.01


@contextmanager
def writing(path: Path | str) -> Iterator[can.Listener]:
    """A listener that writes what it is given to the log, whose format its name's ending says.

    Raises ValueError for an ending that python-can does not know, OSError, which names the file, where it cannot be written.
    """
    if ".mf4" in Path(path).suffixes:
        mf4.provide()
    try:
        if Path(path).suffix.lower() == ".db":
            with _DatabaseWriter(path) as database:
                yield database
                database.wait_until_taken()
            database.check()
            return
        with can.Logger(path) as logger:
            yield logger
    except OSError as error:
        if error.filename is None and error.errno in NO_ROOM:
            error.filename = str(path)
        raise


class _DatabaseWriter(can.SqliteWriter):
    """It writes on a thread of its own, which forgets what is still in the queue when it is stopped, and whose errors nobody
    sees."""

    def __init__(self, path: Path | str) -> None:
        self._path = path
        self._failure: sqlite3.Error | None = None
        super().__init__(path)

    def wait_until_taken(self) -> None:
        """Until the thread has taken all frames. Raises OSError."""
        while not self.buffer.empty():
            if not self._writer_thread.is_alive():
                self.check()
                raise OSError(errno.EIO, "not all frames could be written", str(self._path))
            time.sleep(_POLL_S)

    def check(self) -> None:
        """Raises OSError where not all that was taken could be written."""
        if self._failure is None:
            return
        number = database_errno(self._failure)
        what = os.strerror(number) if number != errno.EIO else str(self._failure)
        raise OSError(number, f"{what}; not all frames could be written", str(self._path)) from self._failure

    def _db_writer_thread(self) -> None:
        try:
            super()._db_writer_thread()
        except sqlite3.Error as error:
            self._failure = error
