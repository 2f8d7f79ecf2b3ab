"""Logs in SQLite are given up after so much processor time, by the file's size."""

from __future__ import annotations

import sqlite3
import time
from pathlib import Path

import pytest

from yieldmon.bus.log_files.sqlite_log import SqliteLog

ROWS = 30_000
COLUMNS = "ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, error INTEGER, dlc INTEGER, data BLOB"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of some megabytes, by its frames' data."""
    path = tmp_path_factory.mktemp("sqlite") / "log.db"
    with sqlite3.connect(path) as database:
        database.execute(f"CREATE TABLE messages ({COLUMNS})")
        rows = ((k / 1000, 0x123, 0, 0, 0, 8, bytes(8) + bytes(60)) for k in range(ROWS))
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, substr(?, 1, 8))", rows)
    database.close()
    return path


@pytest.mark.parametrize("late", [False, True])
def test_reading_is_given_up_after_its_time(log: Path, late: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Five seconds, and five for each megabyte."""
    allowed_s = 5.0 + 5.0 * log.stat().st_size / 1e6
    now_s = 1000.0
    monkeypatch.setattr(time, "thread_time", lambda: now_s)
    opened = SqliteLog(str(log))
    now_s += allowed_s + (0.01 if late else -0.01)
    try:
        if late:
            with pytest.raises(sqlite3.OperationalError, match="interrupted"):
                sum(1 for _ in opened)
        else:
            assert sum(1 for _ in opened) == ROWS
    finally:
        opened.stop()
