"""What can be known of a store's files before they are opened, and opening one that anybody may have made."""

from __future__ import annotations

import errno
import os
import shutil
import sqlite3
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from yieldmon import file_kinds
from yieldmon.bounded import why_no_file
from yieldmon.bounded_sqlite import address, bound
from yieldmon.errors import InputError, reason, remedy
from yieldmon.service.folders import where_sqlite_writes
from yieldmon.service.storage import schema
from yieldmon.service.storage.checksums import row_checksum
from yieldmon.service.storage.store_errors import StoreError
from yieldmon.service.storage.store_names import commit_note_path, file_state, parts

_LARGEST_VALUE_BYTES = 16 * 1024 * 1024
_DEFENSIVE = 1010
"""sqlite3.SQLITE_DBCONFIG_DEFENSIVE, from Python 3.12 on"""
#: Processor time that reading a store which somebody else made may take, s: a part, and so much for each megabyte of it.
_READING_S, _READING_S_PER_MB = 10.0, 1.0
_NOTE_BYTES = 64
_NOT_WAITING = os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOFOLLOW
"""Opening a pipe would wait for its other end."""
_NO_INDEX = (8, 10, 14)
"""SQLITE_READONLY, SQLITE_IOERR and SQLITE_CANTOPEN: what making the journal's index fails with."""
_COPIES = 3
LARGEST_COPY_BYTES = 128 * 1024 * 1024
"""Of a store that is read from a copy: a larger one has no place in the service's memory beside what measures."""


def _tolerant(text: bytes) -> str:
    return text.decode("utf-8", "surrogateescape")


def prepared(database: sqlite3.Connection) -> sqlite3.Connection:
    """A connection to a store: any bytes can be read as text, and SQL knows `row_checksum`."""
    database.text_factory = _tolerant
    database.create_function("row_checksum", -1, row_checksum, deterministic=True)
    return database


def has_journal(path: Path) -> bool:
    """Whether a store has a journal with something in it."""
    journal = parts(path)[1]
    return journal.exists() and journal.stat().st_size > 0


def is_orphaned(path: Path) -> bool:
    """Whether a store is missing, or empty, and its journal is there: SQLite would throw the journal away."""
    return parts(path)[1].is_file() and has_journal(path) and not (path.exists() and path.stat().st_size)


def unwritten(path: Path, timeout_s: float) -> sqlite3.Connection:
    """A connection for which nothing is written, not even a journal's index; it sees nothing of a journal."""
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", timeout=timeout_s, isolation_level=None, uri=True)


def in_memory(path: Path, timeout_s: float) -> sqlite3.Connection:
    """A connection to a copy in memory, for which no room on the medium is needed. Raises StoreError for what is too large."""
    size = sum(part.stat().st_size for part in parts(path)[:2] if part.exists())
    if size > LARGEST_COPY_BYTES:
        expected = f"at most {LARGEST_COPY_BYTES >> 20}"
        raise StoreError(f"{path}: {size >> 20} MB, too large to be read in memory; expected {expected}, or room on its medium")
    source = sqlite3.connect(path, timeout=timeout_s, isolation_level=None) if has_journal(path) else unwritten(path, timeout_s)
    try:
        # Alone with the file SQLite keeps the journal's index in memory.
        source.execute("PRAGMA locking_mode = EXCLUSIVE")
        copy = sqlite3.connect(":memory:", isolation_level=None)
        try:
            source.backup(copy)
        except BaseException:
            copy.close()
            raise
        return copy
    finally:
        source.close()


def header_problem(path: Path) -> str | None:
    """What is wrong with the first bytes of a store that SQLite would take: it would refuse to write, or rearrange the file."""
    try:
        with path.open("rb") as file:
            header = file.read(100)
    except OSError:
        return None
    if len(header) < 100 or not header.startswith(file_kinds.SQLITE):
        return None
    if header[18] not in (1, 2) or header[19] not in (1, 2):
        return "its header asks for another version of the file format"
    if any(header[52:56]) or any(header[64:68]) or any(header[72:92]):
        return "its header is damaged"
    return None


def note_commit(path: Path, batch: int, identity: int = 0) -> None:
    """Note beside the store that a batch was committed, and to which store. A journal that is cut short, or a store put back from
    a copy, looks like a sound one: this says how far it had come. What cannot be noted is not."""
    line = f"{batch} {row_checksum('witness', batch)} {identity} {row_checksum('witness', batch, identity)}\n".encode()
    with suppress(OSError):
        descriptor = os.open(commit_note_path(path), os.O_WRONLY | os.O_CREAT | _NOT_WAITING, 0o600)
        try:
            os.pwrite(descriptor, line.ljust(_NOTE_BYTES), 0)
        finally:
            os.close(descriptor)


def note_beginning(path: Path) -> None:
    """Note that a store is kept here, before its first commit: whatever becomes of its file, it is ours to repair."""
    if not os.path.lexists(commit_note_path(path)):
        note_commit(path, 0)


def last_noted_batch(path: Path) -> int:
    """The last batch that `note_commit` noted, 0 where there is no such note or it is damaged."""
    return _noted(path)[0]


def last_noted_store(path: Path) -> int:
    """The identity of the store that `note_commit` noted the last batch of, 0 where it is not known."""
    return _noted(path)[1]


def _noted(path: Path) -> tuple[int, int]:
    try:
        descriptor = os.open(commit_note_path(path), os.O_RDONLY | _NOT_WAITING)
        try:
            words = os.read(descriptor, _NOTE_BYTES).split()
        finally:
            os.close(descriptor)
        # A note of an earlier version has no identity.
        batch, checksum, *more = (int(word) for word in words)
        identity, both = more or (0, row_checksum("witness", batch, 0))
    except (OSError, ValueError):
        return 0, 0
    sound = (row_checksum("witness", batch), row_checksum("witness", batch, identity)) == (checksum, both)
    return (batch, identity) if sound else (0, 0)


def looks_like_a_store(database: sqlite3.Connection, version: int | None = None) -> bool:
    """Whether the tables are those of a store; with `version`, whether of that version or an older one, whatever
    the header says."""
    tables = {str(name) for (name,) in database.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
    if not {"second", "load", "state", "parameter_set"} <= tables:
        return False
    if version is None or "mark" not in tables:
        return True
    row = database.execute("SELECT value FROM mark WHERE name = 'schema'").fetchone()
    return row is not None and isinstance(row[0], int) and int(row[0]) <= version


def read_only(path: Path) -> sqlite3.Connection:
    """A connection that only reads a store, whether or not a daemon writes it meanwhile; to be closed by the caller.

    Raises InputError when there is no such file, it is no yieldmon store, is damaged, or is of a newer version than this one.
    """
    if not path.is_file():
        raise InputError(str(path), why_no_file(path), "a daemon's store")
    path = where_sqlite_writes(path)
    # Reading beside a writer needs the writer's journal index; without a journal the file alone is the whole store.
    journal = parts(path)[1].exists()
    try:
        opened = _opened(path, "mode=ro" if journal else "immutable=1")
    except InputError as error:
        cause = error.__cause__
        if not (journal and isinstance(cause, sqlite3.OperationalError) and cause.sqlite_errorcode & 0xFF in _NO_INDEX):
            raise
        # A disk that is full or read-only has no room for the index.
        with TemporaryDirectory(prefix="yieldmon-") as folder:
            opened = _opened(_copied(path, Path(folder), error), "mode=ro")
    problem = ""
    if opened.strange:
        kind, name = opened.strange[0]
        problem = f"has a {kind} {name!r} where a store has a plain table"
    elif opened.application != schema.APPLICATION_ID:
        problem = "is empty" if not path.stat().st_size else "is an SQLite file of another program"
    elif not 0 <= opened.version <= schema.VERSION:
        problem = f"is a store of schema version {opened.version}; this yieldmon knows {schema.VERSION}"
    if problem:
        opened.database.close()
        raise InputError(str(path), problem, "a store of this version or an older one")
    return opened.database


@dataclass(frozen=True)
class _Opened:
    """A connection, the identifier of its file's application, the file's version, and kind and name of what no store has."""

    database: sqlite3.Connection
    application: int
    version: int
    strange: Sequence[tuple[str, str]]


def _opened(path: Path, how: str) -> _Opened:
    """The file at a path. how: parameters of SQLite's address. Raises InputError."""
    try:
        database = sqlite3.connect(address(path, how), uri=True, isolation_level=None)
    except sqlite3.OperationalError as error:
        if not os.access(path, os.R_OK, effective_ids=True):
            refusal = OSError(errno.EACCES, os.strerror(errno.EACCES))
            raise InputError(str(path), reason(refusal), remedy(refusal)) from error
        raise InputError(str(path), str(error), "a daemon's store that may be read") from error
    try:
        prepared(database)
        _distrust(database, path)
        application, version = (database.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version"))
        return _Opened(database, application, version, database.execute(_STRANGE).fetchall())
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        # SQLite's own message about a damaged schema may be no text.
        database.close()
        raise InputError(str(path), str(error), "a daemon's store") from error


def _copied(path: Path, folder: Path, why: InputError) -> Path:
    """The file and its journal in another folder, both of one moment. Raises why where a writer goes on changing them."""
    for _ in range(_COPIES):
        before = [file_state(part) for part in parts(path)[:2]]
        try:
            for part in parts(path)[:2]:
                if not part.is_file() or (part != path and part.is_symlink()):
                    raise why
                shutil.copyfile(part, folder / part.name)
        except OSError as error:
            raise why from error
        if before == [file_state(part) for part in parts(path)[:2]]:
            return folder / path.name
    raise why


#: Tables are plain data. The one view that stores have had is not read; triggers run nowhere, since nothing is written.
_STRANGE = f"""
SELECT type, name FROM sqlite_schema
WHERE name IN ({", ".join(repr(name) for name in schema.KEYS)})
  AND (type <> 'table' OR sql LIKE '%GENERATED%' OR sql LIKE 'CREATE VIRTUAL%')
"""


def _distrust(database: sqlite3.Connection, path: Path) -> None:
    """For a file that anybody may have made: nothing in it runs, no value is larger than any store has, and all reading together
    takes CPU time in proportion to its size at most."""
    if hasattr(database, "setconfig"):
        database.setconfig(_DEFENSIVE, True)
    most_cpu_s = _READING_S + _READING_S_PER_MB * path.stat().st_size / 1e6
    bound(database, largest_value_bytes=_LARGEST_VALUE_BYTES, most_cpu_s=most_cpu_s)


def set_aside(path: Path, label: str) -> Path:
    """Rename a damaged store and its journal out of the way, as ``<name>.<label>``, with a number behind where that name is
    taken; returns the new path."""
    aside, count = path.with_name(f"{path.name}.{label}"), 1
    while any(part.exists() for part in parts(aside)):
        count += 1
        aside = path.with_name(f"{path.name}.{label}-{count}")
    for part, target in zip(parts(path), parts(aside), strict=True):
        if os.path.lexists(part):
            part.rename(target)
    return aside


def refuse_foreign_file(path: Path, fstab: Path = Path("/etc/fstab")) -> None:
    """To be asked before a daemon makes or repairs its store: nothing of somebody else's is touched.

    Raises InputError for a file that is no store and never was one, and for a path below a mount point of `fstab` where nothing
    is mounted: the medium would come later and hide what was written.
    """
    missing = unmounted_above(path, fstab)
    if missing is not None:
        raise InputError(str(path), f"{missing} is not mounted", f"its medium (mount {missing}), or another store.path")
    if path.exists() and not path.is_file():
        problem = "is a folder" if path.is_dir() else "is not a file"
        raise InputError(str(path), problem, "a store, or the name of a file that does not exist yet")
    try:
        with path.open("rb") as file:
            begin = file.read(64)
    except OSError:
        return
    a_store_was_here = begin.startswith(file_kinds.SQLITE) or not begin.strip(b"\0") or os.path.lexists(commit_note_path(path))
    if not a_store_was_here:
        raise InputError(
            str(path), "is not a store; it is left as it is", "a store, or the name of a file that does not exist yet"
        )


def unmounted_above(path: Path, fstab: Path = Path("/etc/fstab")) -> Path | None:
    """The mount point of `fstab` that a path lies below and where nothing is mounted, None where there is none."""
    try:
        lines = fstab.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    above = set(path.absolute().parents)
    for line in lines:
        words = line.split()
        if len(words) < 4 or words[0].startswith("#"):
            continue
        place = Path(words[1].replace("\\040", " "))
        if place in above and place != Path("/") and not os.path.ismount(place):
            return place
    return None
