"""Writing logs of every format that python-can writes, to the last frame."""

from __future__ import annotations

import errno
import gzip
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import can

from yieldmon.bus.log_files import mf4
from yieldmon.errors import NO_ROOM, database_errno
from yieldmon.utc import moment

_POLL_S = 0.01


@contextmanager
def writing(path: Path | str) -> Iterator[can.Listener]:
    """A listener that writes what it is given to the log, whose format its name's ending says.

    Raises ValueError for an ending that is none of ENDINGS, OSError, which names the file, where it cannot be written.
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
        with _writer(Path(path)) as logger:
            yield logger
    except OSError as error:
        if error.filename is None and error.errno in NO_ROOM:
            error.filename = str(path)
        raise


def _writer(path: Path) -> can.io.generic.MessageWriter:
    """python-can's, with dates in UTC also where that writes them in the zone of the computer. Raises ValueError, OSError."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    packed = suffixes[-1:] == [".gz"]
    kind = (suffixes[:-1] if packed else suffixes)[-1:] or [""]
    if kind[0] not in _WRITERS:
        raise ValueError(f"{kind[0]!r} is not an ending of a log that can be written")
    if packed and kind[0] not in _TEXT:
        raise ValueError(f"a log {kind[0]} cannot be gzipped while it is written")
    file = gzip.open(path, "wt") if packed else path  # noqa: SIM115 - the writer closes it
    writer: can.io.generic.MessageWriter = _WRITERS[kind[0]](file)
    return writer


class _AscWriter(can.ASCWriter):
    def _format_header_datetime(self, dt: datetime) -> str:
        return super()._format_header_datetime(dt.astimezone(UTC))


class _Mf4Writer(can.MF4Writer):
    def __init__(self, file: Path) -> None:
        super().__init__(file)
        self._mdf.header.start_time = moment(self._start_time)


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


_TEXT = {".log": can.CanutilsLogWriter, ".asc": _AscWriter, ".csv": can.CSVWriter, ".trc": can.TRCWriter}
_WRITERS = {**_TEXT, ".blf": can.BLFWriter, ".mf4": _Mf4Writer, ".db": _DatabaseWriter}
ENDINGS = f"a name that ends in one of {' '.join(_WRITERS)}, the first {len(_TEXT)} also with .gz behind"
"""Of logs that can be written, for a message."""
