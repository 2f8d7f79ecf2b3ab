"""A new store of what is left of a damaged one.

The new one is made whole beside the damaged one and takes its place last, so a power cut in between leaves either; what was begun
is ended at the next start (`finish`). The damaged files are kept under another name.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from time import monotonic, time
from typing import Any

from yieldmon import file_kinds
from yieldmon.bounded_sqlite import address
from yieldmon.engine.records import COLUMNS
from yieldmon.files.whole_file import sync
from yieldmon.service.storage import schema
from yieldmon.service.storage.checksums import UNCHECKED, row_checksum
from yieldmon.service.storage.in_the_way import make_way
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreDetachedError, StoreError
from yieldmon.service.storage.store_file import header_problem, is_orphaned, prepared, set_aside
from yieldmon.service.storage.store_names import being_made_path, parts, ready_path, repaired_path
from yieldmon.service.storage.store_sql import second_is_sound

#: How long copying one-second records may hold up a start; the newest come first, the others stay in the file set aside.
SECONDS_BUDGET_S = 1.5
_SECOND = tuple(item.name for item in fields(SecondRow))
_COLUMNS = {**schema.COLUMNS, "second": _SECOND}
_ROWS_BETWEEN_LOOKS = 500
_STEPS_BETWEEN_LOOKS = 10_000
_HEADER_BYTES, _PAGE_BYTES = 100, 4096
_INTERIOR = 5
_MENDED_AT_MOST_BYTES = 64 * 1024 * 1024
#: What a start depends on, and in what order it is given up when the content makes no sense although it is as it was written.
GIVEN_UP: tuple[tuple[str, ...], ...] = ((), ("state",), ("state", "parameter_set"), tuple(_COLUMNS))


@dataclass
class Rescued:
    """Rows saved and rows found damaged by table; `unreadable` tables have a part that cannot be reached, `left_behind` says that
    older seconds are in the file set aside only."""

    aside: Path
    saved: dict[str, int] = field(default_factory=dict)
    damaged: dict[str, int] = field(default_factory=dict)
    unreadable: list[str] = field(default_factory=list)
    left_behind: bool = False

    def __str__(self) -> str:
        return f"set aside as {self.aside.name}; {self.contents}"

    @property
    def contents(self) -> str:
        """What was saved, and what was not."""
        lost = [f"{count} of {table}" for table, count in self.damaged.items() if count]
        lost += [f"part of {table}" for table in self.unreadable]
        saved = ", ".join(f"{count} of {table}" for table, count in self.saved.items() if count and table != "mark")
        text = f"saved: {saved or 'nothing'}"
        if lost:
            text += f"; lost: {', '.join(lost)}"
        return text + ("; older seconds are in that file only" if self.left_behind else "")


def rescue(path: Path, label: str, *, without: Sequence[str] = ()) -> Rescued:
    """Put a sound store in the place of the damaged one at `path`, with every row of it that is as it was written.

    label: the damaged files are kept as ``<name>.<label>``. without: tables to leave empty. Raises StoreError, or OSError when a
    file cannot be made or renamed.
    """
    fresh = being_made_path(path)
    _remove(fresh)
    rescued = Rescued(path)
    # Opened and closed once: its first page shows what the first page of a store looks like.
    Store(fresh).close()
    with Store(fresh) as store, _opened(path, fresh) as damaged:
        if damaged is not None:
            for table in sorted({*schema.COLUMNS, "second"} & _tables(damaged) - set(without), key=tuple(_COLUMNS).index):
                _copy(damaged, store.path, table, rescued)
    rescued.aside = _replace(path, fresh, label)
    return rescued


def reattach(store: Store, label: str) -> Path | None:
    """Put all that an open store sees into a new file under its name, what is there by now being set aside; returns where.

    For files that were removed or replaced while in use. The store is closed. Raises StoreError or OSError.
    """
    fresh = being_made_path(store.path)
    fresh.parent.mkdir(parents=True, exist_ok=True)
    _remove(fresh)
    store.copy_to(fresh)
    store.close()
    there = any(part.exists() for part in parts(store.path))
    aside = _replace(store.path, fresh, label)
    return aside if there else None


def repair(store: Store | None, path: Path, error: StoreError) -> str:
    """Makes a store that failed in use fit to be opened again; returns what is to be said of it. Raises StoreError or OSError."""
    label = f"{int(time())}"
    if store is not None and isinstance(error, StoreDetachedError):
        aside = reattach(store, f"replaced-{label}")
        there = f", what was there is {aside.name}" if aside is not None else ""
        return f"{error}; rewritten from memory{there}"
    if store is not None:
        store.close()
    return f"damaged, {rescue(path, f'damaged-{label}')}"


def finish(path: Path) -> None:
    """End a replacement that a power cut or a kill interrupted. Raises OSError."""
    if replacement(path) is not None:
        _put_in_place(path, "interrupted")


def replacement(path: Path) -> Path | None:
    """The whole store that was to take the place of another one and has not, None where there is none. Raises OSError."""
    ready = ready_path(path)
    # A link is not of our making: a replacement is a file.
    return ready if ready.is_file() and not ready.is_symlink() else None


def _remove(scratch: Path) -> None:
    """The files of a store of our own that was never finished. What has their names and is no file stays."""
    make_way(parts(scratch))
    for part in parts(scratch):
        part.unlink(missing_ok=True)


def _replace(path: Path, fresh: Path, label: str) -> Path:
    sync(fresh)
    make_way([ready_path(path)])
    fresh.rename(ready_path(path))
    sync(path.parent)
    return _put_in_place(path, label)


def _put_in_place(path: Path, label: str) -> Path:
    aside = set_aside(path, label)
    ready_path(path).rename(path)
    sync(path.parent)
    return aside


@contextmanager
def _opened(path: Path, model: Path) -> Iterator[sqlite3.Connection | None]:
    """The damaged store to be read; a copy with another header or first page where that is what is damaged; None when all fails.
    Of a journal alone, what it has.

    model: an empty store. Tables of one that was made by this version begin at the same pages.
    """
    repaired = repaired_path(path)
    try:
        orphaned = is_orphaned(path)
        database = _readable(path) if header_problem(path) is None and not orphaned else None
        if database is None and (orphaned or (path.exists() and path.stat().st_size <= _MENDED_AT_MOST_BYTES)):
            # Under a journal without its file lies an empty store: tables begin at the same pages.
            content = model.read_bytes() if orphaned else path.read_bytes()
            for candidate in (content, _with_the_schema_of(model.read_bytes(), content)):
                _remove(repaired)
                _write_new(repaired, _with_a_sound_header(candidate))
                journal = parts(path)[1]
                if journal.exists():
                    _write_new(parts(repaired)[1], journal.read_bytes())
                database = database or _readable(repaired)
        try:
            yield database
        finally:
            if database is not None:
                database.close()
    finally:
        _remove(repaired)


def _write_new(path: Path, content: bytes) -> None:
    """Into a file that is made for it: what somebody put there meanwhile, a link to another file say, is not written to."""
    with path.open("xb") as file:
        file.write(content)


def _readable(path: Path) -> sqlite3.Connection | None:
    try:
        database = prepared(sqlite3.connect(address(path, "mode=ro"), uri=True, isolation_level=None))
    except sqlite3.Error:
        return None
    try:
        database.execute("PRAGMA cell_size_check = ON")
        if "second" in _tables(database):
            return database
    except (sqlite3.Error, MemoryError, UnicodeDecodeError):
        pass
    database.close()
    return None


def _tables(database: sqlite3.Connection) -> set[str]:
    return {str(name) for (name,) in database.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}


def _with_the_schema_of(model: bytes, content: bytes) -> bytes:
    """The file with the pages of another one's schema table: the first page and, where that points to others, those."""
    repaired = bytearray(content)
    for page in (1, *_schema_pages(model)):
        if page * _PAGE_BYTES <= len(content):
            place = slice((page - 1) * _PAGE_BYTES, page * _PAGE_BYTES)
            repaired[place] = model[place]
    return bytes(repaired)


def _schema_pages(model: bytes) -> list[int]:
    kind, cells, last = model[_HEADER_BYTES], int.from_bytes(model[103:105], "big"), int.from_bytes(model[108:112], "big")
    if kind != _INTERIOR:
        return []
    pointers = (int.from_bytes(model[at : at + 2], "big") for at in range(112, 112 + 2 * cells, 2))
    return [last, *(int.from_bytes(model[at : at + 4], "big") for at in pointers)]


def _with_a_sound_header(content: bytes) -> bytes:
    """The file with the fields of the header that are the same in every store, or follow from the file's size
    (https://www.sqlite.org/fileformat2.html, section 1.3)."""
    header = bytearray(content[:_HEADER_BYTES].ljust(_HEADER_BYTES, b"\0"))
    header[0:24] = file_kinds.SQLITE + _PAGE_BYTES.to_bytes(2, "big") + bytes((2, 2, 0, 64, 32, 32))
    header[28:40] = (len(content) // _PAGE_BYTES).to_bytes(4, "big") + bytes(8)
    header[44:60] = bytes((0, 0, 0, 4)) + bytes(8) + bytes((0, 0, 0, 1))
    header[64:72] = bytes(4) + schema.APPLICATION_ID.to_bytes(4, "big")
    header[72:92] = bytes(20)
    header[92:96] = header[24:28]
    return bytes(header) + content[_HEADER_BYTES:]


def _copy(damaged: sqlite3.Connection, target: Path, table: str, rescued: Rescued) -> None:
    columns, keyed_by_row = _COLUMNS[table], schema.KEYS[table] == "id"
    names = (*columns, "checksum", *(("id",) if keyed_by_row else ()))
    marks = ", ".join("?" * len(names))
    statement = f"INSERT OR IGNORE INTO {table} ({', '.join(names)}) VALUES ({marks})"
    if table == "mark":
        # The new store has marks of its own; of the old one's only what is said of its rows goes on.
        statement = statement.replace("OR IGNORE", "OR REPLACE")
    end_s = monotonic() + SECONDS_BUDGET_S
    damaged.set_progress_handler(lambda: monotonic() > end_s, _STEPS_BETWEEN_LOOKS)
    unchecked_to = _unchecked_to(damaged) if table == "second" else 0
    with closing(prepared(sqlite3.connect(target, isolation_level=None))) as store:
        store.execute("PRAGMA synchronous = OFF")
        store.execute("BEGIN")
        for row in _rows(damaged, table, names, rescued, end_s):
            values, checksum = row[: len(columns)], row[len(columns)]
            if (table, values[0]) == ("mark", "schema"):
                continue
            if not _is_sound(table, values, checksum, unchecked_to):
                rescued.damaged[table] = rescued.damaged.get(table, 0) + 1
                continue
            try:
                rescued.saved[table] = rescued.saved.get(table, 0) + store.execute(statement, row).rowcount
            except (sqlite3.IntegrityError, OverflowError, UnicodeEncodeError):
                # Of a version without checksums: what no store takes, such as a text that is none.
                rescued.damaged[table] = rescued.damaged.get(table, 0) + 1
        store.execute("COMMIT")
    damaged.set_progress_handler(None, 0)


def _is_sound(table: str, values: tuple[Any, ...], checksum: Any, unchecked_to: int) -> bool:
    if table == "second":
        return second_is_sound(values, checksum, unchecked_to)
    return bool(row_checksum(table, *values) == checksum)


def _rows(
    damaged: sqlite3.Connection, table: str, names: tuple[str, ...], rescued: Rescued, end_s: float
) -> Iterator[tuple[Any, ...]]:
    """Each row that can be reached, from the end and then, where something is in the way, from the beginning."""
    key = schema.KEYS[table]
    old = "mark" not in _tables(damaged)
    without_dry = old and "ticket" not in _tables(damaged)
    later = _later_columns(damaged) if table == "second" else {}
    for order in ("DESC", "ASC"):
        query, count = _query(table, names, key, order, old=old, without_dry=without_dry, later=later), 0
        try:
            # One by one: rows fetched together are lost together when the last of them cannot be reached.
            for row in damaged.execute(query):
                yield _with_checksum(table, row, old)
                count += 1
                if count % _ROWS_BETWEEN_LOOKS == 0 and monotonic() > end_s:
                    rescued.left_behind |= table == "second"
                    return
            return
        except (sqlite3.Error, MemoryError, UnicodeDecodeError):
            if monotonic() > end_s:
                rescued.left_behind |= table == "second"
                return
            if table not in rescued.unreadable:
                rescued.unreadable.append(table)
        # The cursor is a row ahead of what it hands out, so the last row before the damage has not been seen.
        with suppress(sqlite3.Error, MemoryError, UnicodeDecodeError):
            for row in damaged.execute(f"{query} LIMIT 1 OFFSET {count}"):
                yield _with_checksum(table, row, old)


def _later_columns(damaged: sqlite3.Connection) -> dict[str, str]:
    """What stands for the columns of a second that came after the damaged store's version."""
    present = {row[1] for row in damaged.execute("PRAGMA table_info(second)")}
    return {column.name: "NULL" for column in COLUMNS if column.optional and column.since > 1 and column.name not in present}


def _query(
    table: str, names: tuple[str, ...], key: str, order: str, *, old: bool, without_dry: bool, later: Mapping[str, str]
) -> str:
    """The columns of `names` in any version of the schema."""
    instead = dict(later)
    if old:
        instead |= {"checksum": str(UNCHECKED), "slot": "batch % 2"}
        key = "id" if table == "state" else key
    if without_dry:
        instead["dry_mass_kg"] = "NULL"
    columns = ", ".join(instead.get(name, name) for name in names)
    return f"SELECT {columns} FROM {table} ORDER BY {key} {order}"


def _with_checksum(table: str, row: tuple[Any, ...], old: bool) -> tuple[Any, ...]:
    """A row of a store from before checksums passes as it is."""
    if not old:
        return row
    count = len(_COLUMNS[table])
    return (*row[:count], row_checksum(table, *row[:count]), *row[count + 1 :])


def _unchecked_to(damaged: sqlite3.Connection) -> int:
    try:
        rows = damaged.execute("SELECT name, value, checksum FROM mark WHERE name = 'unchecked_seconds'").fetchall()
    except sqlite3.Error:
        return 0
    return next((int(value) for name, value, checksum in rows if row_checksum("mark", name, value) == checksum), 0)
