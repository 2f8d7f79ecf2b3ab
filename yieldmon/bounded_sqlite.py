"""SQLite files that anybody may have made: nothing in them runs, and reading them comes to an end."""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

_LIMIT_LENGTH = 0
"""sqlite3.SQLITE_LIMIT_LENGTH"""
_STEPS_BETWEEN_LOOKS = 100_000


def address(path: Path, how: str) -> str:
    """A file as SQLite takes it with options; a name may be no UTF-8.

    Parameters
    ----------
    path : Path
    how : str
        Options, such as ``mode=ro``.

    Returns
    -------
    str
    """
    return f"file:{quote(os.fsencode(path.absolute()))}?{how}"


def bound(database: sqlite3.Connection, *, largest_value_bytes: int, most_cpu_s: float) -> None:
    """Let nothing in a file run, and bound what reading it takes.

    Parameters
    ----------
    database : sqlite3.Connection
        Opened for reading.
    largest_value_bytes : int
        Larger values are refused.
    most_cpu_s : float
        CPU time of this thread from now on for all reading together, s; what goes on longer is interrupted.

    Raises
    ------
    sqlite3.Error
        As SQLite has it, now and while reading.
    """
    database.execute("PRAGMA trusted_schema = OFF")
    database.execute("PRAGMA cell_size_check = ON")
    database.setlimit(_LIMIT_LENGTH, largest_value_bytes)
    end_s = time.thread_time() + most_cpu_s
    database.set_progress_handler(lambda: time.thread_time() > end_s, _STEPS_BETWEEN_LOOKS)


@contextmanager
def reading() -> Iterator[None]:
    """What the `sqlite3` module makes of a damaged file comes out as its own error.

    Raises
    ------
    sqlite3.Error
        Also where a value's false length asks for memory that there is not, and where SQLite's own message about a damaged schema
        is no text.
    """
    try:
        yield
    except (MemoryError, UnicodeDecodeError) as error:
        raise sqlite3.DatabaseError(str(error) or "a value too large to read") from error
