"""The store: what was measured, and what the monitor needs to go on, in one SQLite file.

A batch is what one second brought: its record, totals, events and the monitor's state. It is committed in one
transaction that is on the medium (WAL, synchronous=FULL) when `commit` returns, so after a power cut the store holds a
whole number of batches: totals that fit the records, never one without the other. Batches are numbered and a number is
committed once only, so a commit whose outcome was unclear can be repeated.

Each row carries a checksum, and what is read is held against it; the state is kept twice, turn about. What cannot be read as it
was written raises StoreDamagedError; `rescue` makes a new store of what is left.

One `Store` belongs to one thread.
"""

from __future__ import annotations

import errno
import os
import sqlite3
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from yieldmon.errors import InputError
from yieldmon.service.storage import schema
from yieldmon.service.storage.batch import Batch
from yieldmon.service.storage.identity import COMPUTER, MARK, NONE, are_two, drawn, marked, of_state
from yieldmon.service.storage.retention import DEFAULT_RETENTION, Retention
from yieldmon.service.storage.store_errors import (
    BatchRefusedError,
    StoreDamagedError,
    StoreDetachedError,
    StoreError,
    failures_of,
    refusals,
)
from yieldmon.service.storage.store_file import (
    has_journal,
    header_problem,
    in_memory,
    is_orphaned,
    looks_like_a_store,
    note_commit,
    prepared,
    read_only,
    unwritten,
)
from yieldmon.service.storage.store_names import parts
from yieldmon.service.storage.store_sql import statements, write, write_in_part, write_mark
from yieldmon.service.storage.stored_rows import StoredRows

#: Tables whose rows a start depends on: read, and held against their checksums, at opening.
_NEEDED = ("mark", "state", "counter", "load", "parameter_set", "ticket", "action")
_EVENTS = ("sweep", "fault", "step")
#: No file has the name; where its folder was may be another thing by now.
_GONE = frozenset({errno.ENOENT, errno.ENOTDIR, errno.ELOOP})
#: How long a commit waits for another process that holds the file.
_WAIT_S = 2.0
#: Rows taken away at a time, so that making room never holds up a second's commit for long.
_PRUNE_ROWS = 2000
#: Updates that measuring again may reach back over.
_KEPT_STEPS = 5000
#: To which SQLite shortens a journal that was longer, when it begins it anew.
_JOURNAL_BYTES = 4 * 1024 * 1024


class Store(StoredRows):
    """An open store; see the module's docstring.

    Raises StoreError from every method when the file or the medium fails; what was committed before stays.
    """

    def __init__(
        self,
        path: Path,
        retention: Retention = DEFAULT_RETENTION,
        *,
        exclusive: bool = False,
        immutable: bool = False,
        copied: bool = False,
        computer: int = NONE,
    ) -> None:
        """Open the store at `path`, making or migrating it when needed.

        exclusive: no other process may read meanwhile, which takes no room on the medium: a store on a full one can be opened and
        read this way. immutable: only read, from a medium that takes no writing at all; not a store with a journal, whose last
        seconds would be missed. copied: only read, from a copy in memory, which is what is migrated: for one of an older version,
        or one that was never made to its end, on a medium without room for that. computer: that writes,
        `identity.this_computer`.

        Raises StoreError when it cannot be opened, StoreDamagedError when it is damaged, InputError when it is another
        program's or of a newer version.
        """
        self.path = path
        self.retention = retention
        with failures_of(path):
            if immutable:
                if has_journal(path):
                    raise StoreError(f"{path}: its journal cannot be read on a medium that takes no writing")
                self._database = unwritten(path, _WAIT_S)
            elif copied:
                self._database = in_memory(path, _WAIT_S)
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                if is_orphaned(path):
                    raise StoreDamagedError(f"{path}: is empty or missing, and its journal is there")
                self._database = sqlite3.connect(path, timeout=_WAIT_S, isolation_level=None)
        self._computer = computer
        self._identities: dict[Path, tuple[int, int]] = {}
        self._sizes: dict[Path, int] = {}
        """Of the files as they were after the last commit; SQLite makes neither shorter while they are open."""
        self._unchecked_to: int | None = 0
        """Seconds up to this number may lack a checksum; None: the store is of a version without any."""
        try:
            with failures_of(path):
                prepared(self._database)
                if exclusive:
                    self._database.execute("PRAGMA locking_mode = EXCLUSIVE")
                self._check_header()
                if not immutable:
                    self._prepare()
                self._check_content()
        except BatchRefusedError as error:
            # Nothing is written at opening but what is there: a version's step cannot take it over.
            self._database.close()
            raise StoreDamagedError(str(error)) from error
        except BaseException:
            self._database.close()
            raise

    @classmethod
    def reading(cls, path: Path) -> Store:
        """The store at `path` to be read only, whether or not a daemon writes it meanwhile. Raises InputError as `read_only`."""
        store = cls.__new__(cls)
        store.path, store.retention, store._database, store._identities = path, Retention(), read_only(path), {}
        store._sizes = {}
        try:
            with failures_of(path):
                checked = store._version() >= schema.CHECKED_FROM
                marked = "SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name = 'mark'"
                if not checked and store._database.execute(marked).fetchone()[0]:
                    # Of an older version there would be nothing to hold its rows against.
                    raise StoreDamagedError(f"{path}: its header is damaged")
                store._unchecked_to = store._mark("unchecked_seconds") if checked else None
        except BaseException:
            store.close()
            raise
        return store

    def _check_header(self) -> None:
        problem = header_problem(self.path)
        if problem is not None:
            raise StoreDamagedError(f"{self.path}: {problem}")
        application, version = self._pragma("application_id"), self._version()
        if application not in (0, schema.APPLICATION_ID) and not looks_like_a_store(self._database):
            raise InputError(str(self.path), "an SQLite file of another program", "a yieldmon store or a new file")
        if (application, version) == (0, 0) and not parts(self.path)[1].exists():
            tables = self._database.execute("SELECT count(*) FROM sqlite_schema WHERE type = 'table'").fetchone()[0]
            if tables and not looks_like_a_store(self._database):
                raise InputError(str(self.path), "an SQLite file of another program", "a yieldmon store or a new file")
        readable = 0 <= version <= schema.VERSION
        if not readable and not looks_like_a_store(self._database, schema.VERSION):
            raise InputError(str(self.path), f"store of schema version {version}", f"{schema.VERSION} at most")
        if application not in (0, schema.APPLICATION_ID) or not readable:
            raise StoreDamagedError(f"{self.path}: its header is damaged")

    def _prepare(self) -> None:
        self._database.execute("PRAGMA journal_mode = WAL")
        self._database.execute("PRAGMA synchronous = FULL")
        self._database.execute("PRAGMA wal_autocheckpoint = 256")
        self._database.execute(f"PRAGMA journal_size_limit = {_JOURNAL_BYTES}")
        for step in range(self._version(), schema.VERSION):
            self._migrate(step)

    def _check_content(self) -> None:
        version = self._version()
        if version != schema.VERSION:
            raise StoreError(f"{self.path}: schema version {version}, which cannot be brought up to {schema.VERSION} here")
        # The one-second records may be hundreds of megabytes; what a start depends on is small.
        for table in _NEEDED + _EVENTS:
            finding = self._pragma(f"quick_check({table})")
            if finding != "ok":
                raise StoreDamagedError(f"{self.path}: damaged: {finding}")
        for table in _NEEDED:
            self._checked(table)
        if self._mark("schema") != version:
            raise StoreDamagedError(f"{self.path}: its header is damaged")
        self._unchecked_to = self._mark("unchecked_seconds")
        self.last_second()

    def _migrate(self, step: int) -> None:
        with self._transaction():
            for statement in statements(schema.MIGRATIONS[step]):
                self._database.execute(statement)
            self._database.execute(f"PRAGMA application_id = {schema.APPLICATION_ID}")
            self._database.execute(f"PRAGMA user_version = {step + 1}")
            if step + 1 >= schema.CHECKED_FROM:
                write_mark(self._database, "schema", step + 1)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._database.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._database.execute("COMMIT")
        except BaseException:
            if self._database.in_transaction:
                self._database.execute("ROLLBACK")
            raise

    def commit(self, batches: Sequence[Batch]) -> None:
        """Write `batches`, in order, in one transaction; those whose number the store already has are left out.

        Raises StoreError, also where the file system has turned read-only, and BatchRefusedError.
        """
        with self._committing() as (before, identity):
            last = before
            for batch in batches:
                if batch.number > last:
                    write(self._database, batch, identity)
                    last = batch.number
        self._committed(last, identity)

    def commit_in_part(self, batch: Batch) -> list[str]:
        """Write what the store takes of a batch that `commit` refuses, in one transaction; returns which rows were left out, and
        why. Raises StoreError."""
        with self._committing() as (before, identity):
            left_out = write_in_part(self._database, batch, identity) if batch.number > before else []
            last = self.last_batch()
        self._committed(last, identity)
        return left_out

    @contextmanager
    def _committing(self) -> Iterator[tuple[int, int]]:
        """A transaction; gives the last batch's number and the store's own."""
        self._require_writable()
        with failures_of(self.path), refusals(self.path), self._transaction():
            identity = marked(self._database)
            if identity == NONE:
                identity = drawn(self._database)
                write_mark(self._database, MARK, identity)
            if self._computer not in (NONE, marked(self._database, COMPUTER)):
                write_mark(self._database, COMPUTER, self._computer)
            yield self.last_batch(), identity

    def _committed(self, last: int, identity: int) -> None:
        note_commit(self.path, last, identity)
        for part in parts(self.path)[:2]:
            with suppress(OSError):
                self._sizes[part] = min(part.stat().st_size, _JOURNAL_BYTES if part != self.path else sys.maxsize)

    def identity(self) -> int:
        """The store's own number, drawn at its first commit; `identity.NONE` before. Raises StoreDamagedError where the state was
        committed to another store."""
        with failures_of(self.path):
            ours, of_last = marked(self._database), of_state(self._database)
        if are_two(ours, of_last):
            raise StoreDamagedError(f"{self.path}: its file and its journal are of two stores")
        return ours

    def computer(self) -> int:
        """The computer that made the last commit, `identity.NONE` where it is not known."""
        with failures_of(self.path):
            return marked(self._database, COMPUTER)

    def _require_writable(self) -> None:
        # On a file system that Linux has remounted read-only, writes into a journal that has room succeed and so does fsync
        # (ext4), and nothing reaches the medium.
        try:
            flags = os.statvfs(self.path).f_flag
        except OSError:
            return  # the commit says more
        if flags & os.ST_RDONLY:
            raise StoreError(f"{self.path}: its file system has turned read-only")

    def require_attached(self) -> None:
        """Raises StoreDetachedError when a file that is open has been removed or replaced under its name, so that what is
        committed would be lost with the process, StoreDamagedError or StoreError when somebody has cut one short."""
        for part in parts(self.path):
            try:
                found = os.stat(part)
            except OSError as error:
                # A medium that fails is reported by the commit.
                if error.errno in _GONE and (part in self._identities or part == self.path):
                    raise StoreDetachedError(f"{part}: removed while in use") from None
                continue
            identity = (found.st_dev, found.st_ino)
            if self._identities.setdefault(part, identity) != identity or not found.st_nlink:
                raise StoreDetachedError(f"{part}: replaced while in use")
            if found.st_size < self._sizes.get(part, 0):
                cut = f"{part}: cut to {found.st_size} bytes while in use"
                # A journal may have been written into the file by another process: opening them anew shows it.
                raise StoreDamagedError(cut) if part == self.path else StoreError(cut)

    def copy_to(self, target: Path) -> None:
        """Write all that this connection sees into a new file at `target`. Raises StoreError."""
        with failures_of(target):
            copy = sqlite3.connect(target, isolation_level=None)
            try:
                self._database.backup(copy)
            finally:
                copy.close()

    def prune(self) -> int:
        """Take away the oldest rows that retention no longer keeps, a few thousand at most; returns how many went."""
        with failures_of(self.path), self._transaction():
            gone = self._delete_oldest("second", "number", int(self.retention.record_hours * 3600))
            if self.size_bytes() > self.retention.size_mb * 1e6:
                gone += self._delete_oldest("second", "number", 0)
            for table in ("sweep", "fault"):
                gone += self._delete_oldest(table, schema.KEYS[table], self.retention.event_rows)
            gone += self._delete_oldest("step", "version", _KEPT_STEPS)
        return gone

    def _delete_oldest(self, table: str, key: str, keep: int) -> int:
        first, last = self._database.execute(f"SELECT min({key}), max({key}) FROM {table}").fetchone()
        if first is None:
            return 0
        bound = min(last - keep, first + _PRUNE_ROWS - 1)
        return int(self._database.execute(f"DELETE FROM {table} WHERE {key} <= ?", (bound,)).rowcount)

    def size_bytes(self) -> int:
        """Bytes in use in the main file (pages free for use again not counted)."""
        pages_in_use = int(self._pragma("page_count")) - int(self._pragma("freelist_count"))
        return pages_in_use * int(self._pragma("page_size"))
