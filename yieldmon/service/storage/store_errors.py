"""How a store fails: by its medium, its content, its name, or what it is given."""

from __future__ import annotations

import errno
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from yieldmon.errors import InputError, remedy
from yieldmon.service.storage.store_names import parts, rollback_path


class StoreError(Exception):
    """The medium or the file fails: full, read-only, not a store, damaged. One line."""


class StoreDamagedError(StoreError):
    """The file's content is broken, or no store at all; another medium or more room would not help."""


class StoreUnreadableError(StoreError):
    """The medium gives back nothing of the file, neither in place nor for a copy."""


class StoreDetachedError(StoreError):
    """The file that is open is not the one under its name any more: somebody removed or replaced it."""


class BatchRefusedError(StoreError):
    """A batch that no store can take, because a value breaks the schema; trying again cannot help."""


#: Results of SQLite that speak of the file's content. A schema that lacks what the version has is SQLITE_ERROR.
_DAMAGE = tuple(
    f"SQLITE_{name}"
    for name in (
        "CORRUPT",
        "NOTADB",
        "ERROR",
        "SCHEMA",
        "FORMAT",
        "INTERNAL",
        "TOOBIG",
        "NOMEM",
        "IOERR_SHORT_READ",
        "IOERR_CORRUPTFS",
    )
)


@contextmanager
def failures_of(path: Path) -> Iterator[None]:
    """What SQLite and the system say of a store's file comes out as a StoreError that names the file."""
    try:
        yield
    except (InputError, StoreError):
        raise
    except (sqlite3.DatabaseError, OSError) as error:
        if isinstance(error, sqlite3.IntegrityError):
            raise BatchRefusedError(f"{path}: {error}") from error
        damaged = getattr(error, "sqlite_errorname", "").startswith(_DAMAGE)
        why = "" if damaged else _forbidden(path, error)
        raise (StoreDamagedError if damaged else StoreError)(f"{path}: {error}{why}") from error
    except (MemoryError, UnicodeDecodeError, sqlite3.Error) as error:
        # SQLite's own message about a damaged schema may be no text.
        raise StoreDamagedError(f"{path}: {error or 'a value too large to read'}") from error


def _forbidden(path: Path, error: Exception) -> str:
    """What the system does not let this user do with a store, which SQLite calls "unable to open" or "disk I/O error"; empty
    where it is something else. Follows SQLite's words."""
    name = getattr(error, "sqlite_errorname", "")
    if not name.startswith(("SQLITE_CANTOPEN", "SQLITE_IOERR", "SQLITE_READONLY")):
        return ""
    # What cannot be read for another reason is not read better by whoever may write it.
    needed = os.R_OK if name.startswith("SQLITE_IOERR") else os.R_OK | os.W_OK
    for part in (path.parent, *parts(path)[:2], rollback_path(path)):
        also = os.X_OK if part == path.parent else 0
        if os.path.lexists(part) and not os.access(part, needed | also, effective_ids=True):
            refusal = OSError(errno.EACCES, os.strerror(errno.EACCES))
            return f" ({part}: {refusal.strerror}; expected {remedy(refusal)})"
    return ""


@contextmanager
def refusals(path: Path) -> Iterator[None]:
    """For what is written: numbers, texts and types that SQLite or JSON cannot hold."""
    try:
        yield
    except (sqlite3.Error, TypeError, ValueError, OverflowError) as error:
        if not breaks_schema(error):
            raise
        raise BatchRefusedError(f"{path}: {error}") from error


def breaks_schema(error: Exception) -> bool:
    """Whether what SQLite, or the making of a row, says is about the values and not about the file or the medium."""
    if isinstance(error, UnicodeDecodeError):
        return False
    # Values of a type that SQLite does not hold are reported as a mistake of the caller's.
    binding = isinstance(error, sqlite3.ProgrammingError | sqlite3.InterfaceError) and "binding parameter" in str(error)
    return binding or isinstance(error, sqlite3.IntegrityError | TypeError | ValueError | OverflowError)
