"""Logs that python-can's SqliteWriter writes, read as files that anybody may have made."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can

from yieldmon.bounded_sqlite import address, bound, reading
from yieldmon.bus.log_files.frame_check import with_fd_by_length

SUFFIX = ".db"
_COLUMNS = "ts, arbitration_id, extended, remote, error, dlc, data"
_LARGEST_VALUE_BYTES = 4096
#: Processor time for all reading together, s: a part, and so much for each megabyte of the file.
_READING_S, _READING_S_PER_MB = 5.0, 5.0


class SqliteLog:
    """Iterable of the frames; `stop` closes the file. Raises sqlite3.Error or ValueError for one that is no such log."""

    def __init__(self, path: str) -> None:
        where = address(Path(path), "mode=ro&immutable=1")
        self._database = sqlite3.connect(where, uri=True, isolation_level=None)
        try:
            most_cpu_s = _READING_S + _READING_S_PER_MB * Path(path).stat().st_size / 1e6
            bound(self._database, largest_value_bytes=_LARGEST_VALUE_BYTES, most_cpu_s=most_cpu_s)
            with reading():
                found = self._database.execute("SELECT type, sql FROM sqlite_schema WHERE name = 'messages'").fetchone()
            if found is None or found[0] != "table" or "GENERATED" in str(found[1]).upper() or "VIRTUAL" in str(found[1]).upper():
                raise ValueError("no table 'messages' as python-can's SqliteWriter makes it")
        except BaseException:
            self._database.close()
            raise

    def __iter__(self) -> Iterator[can.Message]:
        for ts, identifier, extended, remote, error, dlc, data in self._rows():
            if not isinstance(data, bytes):
                # A bytearray of a number would be as many zeros.
                raise ValueError(f"its data are not bytes but {data!r:.40}")
            message = can.Message(
                timestamp=float(ts), arbitration_id=int(identifier), is_extended_id=bool(extended), is_remote_frame=bool(remote),
                is_error_frame=bool(error), dlc=int(dlc), data=data,
            )  # fmt: skip
            yield with_fd_by_length(message)

    def _rows(self) -> Iterator[tuple[Any, ...]]:
        with reading():
            yield from self._database.execute(f"SELECT {_COLUMNS} FROM messages")

    def stop(self) -> None:
        """Close the file."""
        self._database.close()


def is_log(path: str | Path) -> bool:
    """Whether a file is such a log; False also for one that is missing or damaged."""
    if not Path(path).is_file():
        return False
    try:
        SqliteLog(str(path)).stop()
    except (sqlite3.Error, ValueError, OSError):
        return False
    return True
