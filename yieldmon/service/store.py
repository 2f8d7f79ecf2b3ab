"""The store: what was measured, and what the monitor needs to go on, in one SQLite file.

A batch is what one second brought: its record, totals, events and the monitor's state. It is committed in one
transaction that is on the medium (WAL, synchronous=FULL) when `commit` returns, so after a power cut the store holds a
whole number of batches: totals that fit the records, never one without the other. Batches are numbered and a number is
committed once only, so a commit whose outcome was unclear can be repeated.

One `Store` belongs to one thread.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass, field, fields
from pathlib import Path
from typing import Any
from urllib.parse import quote

from yieldmon.errors import InputError
from yieldmon.service import schema
from yieldmon.service.rows import SecondRow


@dataclass(frozen=True)
class Load:
    """A load: from one emptying of the tank, or one `load start`, to the next. `ended_s` is None while it is open."""

    number: int
    field: str
    crop: str
    started_s: float | None
    ended_s: float | None
    mass_kg: float
    dry_mass_kg: float | None


@dataclass(frozen=True)
class SweepRecord:
    """How a self-calibration sweep ended."""

    time_s: float
    outcome: str
    reason: str
    document: Mapping[str, Any]


@dataclass(frozen=True)
class ParameterVersion:
    """A parameter set that came into use; `document` has values, covariance and provenance."""

    version: int
    time_s: float
    origin: str
    document: Mapping[str, Any]


@dataclass(frozen=True)
class FaultEvent:
    """A fault that came (`active`) or went."""

    time_s: float
    code: str
    active: bool
    detail: str = ""


@dataclass(frozen=True)
class Ticket:
    """A weighed mass, kg, for the loads `first_load`..`last_load`, beside what was measured for them, kg."""

    time_s: float
    first_load: int
    last_load: int
    weighed_mass_kg: float
    measured_mass_kg: float
    note: str = ""

    @property
    def factor(self) -> float:
        """Weighed over measured."""
        return self.weighed_mass_kg / self.measured_mass_kg


@dataclass(frozen=True)
class Batch:
    """All that one second brought. `number` rises by one from batch to batch over the store's life."""

    number: int
    time_s: float
    state: Mapping[str, Any]
    seconds: tuple[SecondRow, ...] = ()
    loads: tuple[Load, ...] = ()
    sweeps: tuple[SweepRecord, ...] = ()
    parameter_versions: tuple[ParameterVersion, ...] = ()
    faults: tuple[FaultEvent, ...] = ()
    tickets: tuple[Ticket, ...] = ()
    counters: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Retention:
    """What is kept: the newest `record_hours` hours of one-second records, fewer when the file would pass `size_mb` MB,
    and the newest `event_rows` sweeps, faults and tickets. Loads and parameter versions are few and stay.

    Hours are hours of records, so a clock that is wrong by years takes nothing away.
    """

    record_hours: float = 2000.0
    size_mb: float = 512.0
    event_rows: int = 100_000


class StoreError(Exception):
    """The medium or the file fails: full, read-only, not a store, damaged. One line."""


class StoreDamagedError(StoreError):
    """The file's content is broken, or no store at all; another medium or more room would not help."""


class BatchRefusedError(StoreError):
    """A batch that no store can take, because a value breaks the schema; trying again cannot help."""


def _columns(row_type: type) -> str:
    return ", ".join(f.name for f in fields(row_type))


def _marks(row_type: type) -> str:
    return ", ".join("?" * len(fields(row_type)))


def _json(document: Mapping[str, Any]) -> str:
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)


_INSERT_SECOND = f"INSERT INTO second ({_columns(SecondRow)}) VALUES ({_marks(SecondRow)})"
_UPSERT_LOAD = f"INSERT OR REPLACE INTO load ({_columns(Load)}) VALUES ({_marks(Load)})"
_INSERT_SWEEP = f"INSERT INTO sweep ({_columns(SweepRecord)}) VALUES (?, ?, ?, ?)"
_UPSERT_PARAMETERS = f"INSERT OR REPLACE INTO parameter_set ({_columns(ParameterVersion)}) VALUES (?, ?, ?, ?)"
_INSERT_FAULT = f"INSERT INTO fault ({_columns(FaultEvent)}) VALUES (?, ?, ?, ?)"
_INSERT_TICKET = f"INSERT INTO ticket ({_columns(Ticket)}) VALUES ({_marks(Ticket)})"
_UPSERT_COUNTER = "INSERT OR REPLACE INTO counter (name, value) VALUES (?, ?)"
_UPSERT_STATE = "INSERT OR REPLACE INTO state (id, batch, time_s, document) VALUES (1, ?, ?, ?)"

#: Rows taken away at a time, so that making room never holds up a second's commit for long.
_PRUNE_ROWS = 2000


@contextmanager
def _failures_of(path: Path) -> Iterator[None]:
    try:
        yield
    except (InputError, StoreError):
        raise
    except (sqlite3.IntegrityError, ValueError) as error:
        raise BatchRefusedError(f"{path}: {error}") from error
    except (sqlite3.DatabaseError, OSError) as error:
        damaged = getattr(error, "sqlite_errorname", "").startswith(("SQLITE_CORRUPT", "SQLITE_NOTADB"))
        raise (StoreDamagedError if damaged else StoreError)(f"{path}: {error}") from error


class Store:
    """An open store; see the module's docstring.

    Raises StoreError from every method when the file or the medium fails; what was committed before stays.
    """

    def __init__(
        self,
        path: Path,
        retention: Retention = Retention(),
        timeout_s: float = 2.0,
        exclusive: bool = False,
        immutable: bool = False,
    ) -> None:
        """Open the store at `path`, making or migrating it when needed.

        timeout_s: how long a commit waits for another process that holds the file. exclusive: nobody else may read
        meanwhile, which takes no room on the medium: a store on a full one can be opened and read this way. immutable: only
        read, from a medium that takes no writing at all; not a store with a journal, whose last seconds would be missed.

        Raises StoreError when it cannot be opened, StoreDamagedError when it is damaged, InputError when it is another
        program's or of a newer version.
        """
        self.path = path
        self.retention = retention
        with _failures_of(path):
            if immutable:
                _refuse_journal(path)
                address = f"{path.absolute().as_uri()}?immutable=1"
                self._database = sqlite3.connect(address, timeout=timeout_s, isolation_level=None, uri=True)
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                self._database = sqlite3.connect(path, timeout=timeout_s, isolation_level=None)
        try:
            with _failures_of(path):
                if exclusive:
                    self._database.execute("PRAGMA locking_mode = EXCLUSIVE")
                self._check_header()
                if not immutable:
                    self._prepare()
                self._check_content()
        except BaseException:
            self._database.close()
            raise

    @classmethod
    def reading(cls, path: Path) -> Store:
        """The store at `path` to be read only, whether or not a daemon writes it meanwhile. Raises InputError as `read_only`."""
        store = cls.__new__(cls)
        store.path, store.retention, store._database = path, Retention(), read_only(path)
        return store

    def _check_header(self) -> None:
        if self._pragma("application_id") not in (0, schema.APPLICATION_ID):
            raise InputError(str(self.path), "an SQLite file of another program", "a yieldmon store or a new file")
        version = self._pragma("user_version")
        if version > schema.VERSION:
            raise InputError(str(self.path), f"store of schema version {version}", f"{schema.VERSION} at most")

    def _prepare(self) -> None:
        self._database.execute("PRAGMA journal_mode = WAL")
        self._database.execute("PRAGMA synchronous = FULL")
        self._database.execute("PRAGMA wal_autocheckpoint = 256")
        self._database.execute("PRAGMA journal_size_limit = 4194304")
        for step in range(self._pragma("user_version"), schema.VERSION):
            self._migrate(step)

    def _check_content(self) -> None:
        version = self._pragma("user_version")
        if version != schema.VERSION:
            raise StoreError(f"{self.path}: schema version {version}, which cannot be brought up to {schema.VERSION} here")
        # The one-second records may be hundreds of megabytes; what a start depends on is small.
        for table in ("state", "counter", "load", "parameter_set"):
            finding = self._pragma(f"quick_check({table})")
            if finding != "ok":
                raise StoreDamagedError(f"{self.path}: damaged: {finding}")

    def _migrate(self, step: int) -> None:
        with self._transaction():
            for statement in _statements(schema.MIGRATIONS[step]):
                self._database.execute(statement)
            self._database.execute(f"PRAGMA application_id = {schema.APPLICATION_ID}")
            self._database.execute(f"PRAGMA user_version = {step + 1}")

    def _pragma(self, name: str) -> Any:
        return self._database.execute(f"PRAGMA {name}").fetchone()[0]

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

    def close(self) -> None:
        """Close the file. What was committed is safe with or without it."""
        self._database.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def commit(self, batches: Sequence[Batch]) -> None:
        """Write `batches`, in order, in one transaction; those whose number the store already has are left out."""
        with _failures_of(self.path), self._transaction():
            last = self.last_batch()
            for batch in batches:
                if batch.number > last:
                    self._write(batch)
                    last = batch.number

    def _write(self, batch: Batch) -> None:
        execute, executemany = self._database.execute, self._database.executemany
        executemany(_INSERT_SECOND, map(astuple, batch.seconds))
        executemany(_UPSERT_LOAD, map(astuple, batch.loads))
        executemany(_INSERT_SWEEP, ((s.time_s, s.outcome, s.reason, _json(s.document)) for s in batch.sweeps))
        executemany(
            _UPSERT_PARAMETERS, ((p.version, p.time_s, p.origin, _json(p.document)) for p in batch.parameter_versions)
        )
        executemany(_INSERT_FAULT, map(astuple, batch.faults))
        executemany(_INSERT_TICKET, map(astuple, batch.tickets))
        executemany(_UPSERT_COUNTER, batch.counters.items())
        execute(_UPSERT_STATE, (batch.number, batch.time_s, _json(batch.state)))

    def prune(self) -> int:
        """Take away the oldest rows that retention no longer keeps, a few thousand at most; returns how many went."""
        with _failures_of(self.path), self._transaction():
            gone = self._delete_oldest("second", "number", int(self.retention.record_hours * 3600))
            if self.size_bytes() > self.retention.size_mb * 1e6:
                gone += self._delete_oldest("second", "number", 0)
            for table in ("sweep", "fault", "ticket"):
                gone += self._delete_oldest(table, "id", self.retention.event_rows)
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

    def last_batch(self) -> int:
        """Number of the last batch committed, 0 in a new store."""
        row = self._database.execute("SELECT batch FROM state").fetchone()
        return 0 if row is None else int(row[0])

    def state(self) -> dict[str, Any] | None:
        """The monitor's state of the last batch, None in a new store."""
        with _failures_of(self.path):
            row = self._database.execute("SELECT document FROM state").fetchone()
            return None if row is None else json.loads(row[0])

    def seconds(self, first_number: int = 0) -> list[SecondRow]:
        """One-second records from `first_number` on, in order."""
        return self._rows(SecondRow, "second WHERE number >= ? ORDER BY number", (first_number,))

    def last_second(self) -> SecondRow | None:
        """The newest one-second record."""
        rows: list[SecondRow] = self._rows(SecondRow, "second ORDER BY number DESC LIMIT 1")
        return rows[0] if rows else None

    def loads(self) -> list[Load]:
        """All loads as measured, in order."""
        return self._rows(Load, "load ORDER BY number")

    def corrected_loads(self) -> list[dict[str, Any]]:
        """All loads with the mass measured and the mass corrected by the newest ticket that covers each."""
        with _failures_of(self.path):
            cursor = self._database.execute("SELECT * FROM load_corrected ORDER BY number")
            names = [column[0] for column in cursor.description]
            return [dict(zip(names, row, strict=True)) for row in cursor]

    def tickets(self) -> list[Ticket]:
        """All tickets in the order they were entered."""
        return self._rows(Ticket, "ticket ORDER BY id")

    def faults(self, limit: int = 100) -> list[FaultEvent]:
        """The newest `limit` fault events, oldest first."""
        rows: list[FaultEvent] = self._rows(FaultEvent, "fault ORDER BY id DESC LIMIT ?", (limit,))
        return [FaultEvent(r.time_s, r.code, bool(r.active), r.detail) for r in reversed(rows)]

    def sweeps(self, limit: int = 100) -> list[SweepRecord]:
        """The newest `limit` sweeps, oldest first."""
        rows: list[SweepRecord] = self._rows(SweepRecord, "sweep ORDER BY id DESC LIMIT ?", (limit,))
        return [SweepRecord(r.time_s, r.outcome, r.reason, json.loads(str(r.document))) for r in reversed(rows)]

    def parameter_versions(self) -> list[ParameterVersion]:
        """All parameter versions, in order."""
        rows: list[ParameterVersion] = self._rows(ParameterVersion, "parameter_set ORDER BY version")
        return [ParameterVersion(r.version, r.time_s, r.origin, json.loads(str(r.document))) for r in rows]

    def counters(self) -> dict[str, int]:
        """Counters by name."""
        with _failures_of(self.path):
            return dict(self._database.execute("SELECT name, value FROM counter").fetchall())

    def _rows(self, row_type: type, source: str, values: Iterable[Any] = ()) -> list[Any]:
        with _failures_of(self.path):
            cursor = self._database.execute(f"SELECT {_columns(row_type)} FROM {source}", tuple(values))
            return [row_type(*row) for row in cursor]


def read_only(path: Path) -> sqlite3.Connection:
    """A connection that only reads a store, whether or not a daemon writes it meanwhile; to be closed by the caller.

    Raises InputError when there is no such file, it is no yieldmon store, is damaged, or is of a newer version than this one.
    """
    if not path.is_file():
        raise InputError(str(path), "no such file", "a daemon's store")
    # Reading beside a writer needs the writer's journal index; without a journal the file alone is the whole store.
    quiet = not path.with_name(f"{path.name}-wal").exists()
    location = f"file:{quote(str(path.absolute()))}?{'immutable=1' if quiet else 'mode=ro'}"
    try:
        database = sqlite3.connect(location, uri=True, isolation_level=None)
    except sqlite3.OperationalError as error:
        raise InputError(str(path), str(error), "a daemon's store that may be read") from error
    try:
        application, version = (
            database.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")
        )
    except sqlite3.DatabaseError as error:
        database.close()
        raise InputError(str(path), str(error), "a daemon's store") from error
    problem = ""
    if application != schema.APPLICATION_ID:
        problem = "is an SQLite file of another program"
    elif version > schema.VERSION:
        problem = f"is a store of schema version {version}; this yieldmon knows {schema.VERSION}"
    if problem:
        database.close()
        raise InputError(str(path), problem, "a store of this version or an older one")
    return database


def _refuse_journal(path: Path) -> None:
    journal = path.with_name(f"{path.name}-wal")
    if journal.exists() and journal.stat().st_size:
        raise StoreError(f"{path}: its journal cannot be read on a medium that takes no writing")


def _statements(script: str) -> Iterator[str]:
    """The statements of a script one by one: executescript() would commit the transaction around them."""
    statement = ""
    for line in script.splitlines(keepends=True):
        statement += line
        if sqlite3.complete_statement(statement):
            yield statement
            statement = ""


def set_aside(path: Path, label: str) -> Path:
    """Rename a damaged store and its journal out of the way, as ``<name>.<label>``; returns the new path."""
    aside = path.with_name(f"{path.name}.{label}")
    for suffix in ("", "-wal", "-shm"):
        part = path.with_name(path.name + suffix)
        if part.exists():
            part.rename(aside.with_name(aside.name + suffix))
    return aside
