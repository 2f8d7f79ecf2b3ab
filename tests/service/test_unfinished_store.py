"""A store of an older version, or one that was never made to its end, on a medium that has no room to bring it up to date."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from yieldmon.service.history.recovery import recover
from yieldmon.service.storage import schema, store_file, store_names
from yieldmon.service.storage.batch import Batch
from yieldmon.service.storage.retention import DEFAULT_RETENTION
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreError
from yieldmon.service.storage.store_sql import statements

OLD = Path(__file__).resolve().parents[1] / "golden" / "store-0.1.0.sqlite"


def fill(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on no file of a database can grow."""
    connect = sqlite3.connect

    def limited(path: Any, *given: Any, **how: Any) -> sqlite3.Connection:
        database = connect(path, *given, **how)
        if path != ":memory:" and "immutable" not in str(path):
            database.execute("PRAGMA max_page_count = 1")
        return database

    monkeypatch.setattr("sqlite3.connect", limited)


def begun(path: Path, steps: int, *, journal: bool) -> Path:
    """A store as far as its first steps; with `journal` they are in there, as a kill leaves them."""
    database = sqlite3.connect(path, isolation_level=None)
    database.execute("PRAGMA journal_mode = WAL")
    store_file.prepared(database)
    for step in range(steps):
        for statement in statements(schema.MIGRATIONS[step]):
            database.execute(statement)
        database.execute(f"PRAGMA application_id = {schema.APPLICATION_ID}")
        database.execute(f"PRAGMA user_version = {step + 1}")
    if journal:
        kept = {part: part.read_bytes() for part in store_names.parts(path)[:2] if part.exists()}
    database.close()
    if journal:
        for part, content in kept.items():
            part.write_bytes(content)
    return path


@pytest.mark.parametrize("journal", [False, True])
@pytest.mark.parametrize("steps", [0, 1, 5])
def test_one_that_was_never_made_to_its_end_does_not_stop_the_measuring(tmp_path, monkeypatch, steps, journal):
    path = begun(tmp_path / "s.sqlite", steps, journal=journal)
    fill(monkeypatch)
    found = recover(path, DEFAULT_RETENTION, lambda: Store(path))
    assert (found.memory.engine, found.last_batch, found.note) == (None, 0, "")


def test_it_is_made_to_its_end_once_there_is_room(tmp_path):
    path = begun(tmp_path / "s.sqlite", 3, journal=True)
    recover(path, DEFAULT_RETENTION, lambda: Store(path))
    with Store(path) as store:
        store.commit([Batch(1, 1.0, {})])
        assert store.last_batch() == 1


@pytest.mark.parametrize("journal", [False, True])
def test_one_of_an_older_version_is_remembered_whole(tmp_path, monkeypatch, journal):
    path, other = tmp_path / "s.sqlite", tmp_path / "other.sqlite"
    shutil.copyfile(OLD, path)
    if journal:
        database = sqlite3.connect(path, isolation_level=None)
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("UPDATE counter SET value = value + 1")
        kept = {part: part.read_bytes() for part in store_names.parts(path)[:2]}
        database.close()
        for part, content in kept.items():
            part.write_bytes(content)
        assert store_file.has_journal(path)
    for part in store_names.parts(path)[:2]:
        if part.exists():
            shutil.copyfile(part, tmp_path / part.name.replace("s.", "other."))
    due = recover(other, DEFAULT_RETENTION, lambda: Store(other)).memory
    fill(monkeypatch)
    found = recover(path, DEFAULT_RETENTION, lambda: Store(path))
    for name in ("engine", "saved_s", "last_second", "last_version", "loads", "tickets", "actions", "counters"):
        assert repr(getattr(found.memory, name)) == repr(getattr(due, name)), name
    assert found.memory.engine.totals.total_kg > 0.0
    assert found.memory.counters
    assert found.last_batch > 0


def test_one_that_is_too_large_for_memory_is_reported(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(store_file, "LARGEST_COPY_BYTES", 1)
    path = begun(tmp_path / "s.sqlite", 3, journal=False)
    fill(monkeypatch)
    with pytest.raises(StoreError, match="database or disk is full"):
        recover(path, DEFAULT_RETENTION, lambda: Store(path))
    assert "too large to be read in memory" in caplog.text
