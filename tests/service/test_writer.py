"""The store's thread: order, retries, giving up records but never totals."""

from __future__ import annotations

import os
import threading
import types
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.service.bench import wait_for
from tests.service.test_store import batch
from yieldmon.service.batch import Batch, Ticket
from yieldmon.service.store import Store
from yieldmon.service.store_errors import StoreError
from yieldmon.service.writer import StoreWriter

PATIENCE_S = 60.0


class Disk:
    """Opens stores on a path; `broken` makes every commit fail."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.broken = threading.Event()
        self.refusals = threading.Semaphore(0)

    def open(self) -> Store:
        disk = self

        class Fragile(Store):
            def commit(self, batches: tuple[Batch, ...]) -> None:
                if disk.broken.is_set():
                    disk.refusals.release()
                    raise StoreError(f"{disk.path}: disk I/O error")
                super().commit(batches)

        return Fragile(self.path)


@pytest.fixture
def disk(tmp_path) -> Disk:
    return Disk(tmp_path / "s")


def rows(disk: Disk) -> list[int]:
    with Store(disk.path) as store:
        return [row.number for row in store.seconds()]


def test_batches_are_written_in_order(disk):
    writer = StoreWriter(disk.open, 100)
    writer.start()
    for number in range(1, 51):
        writer.submit(batch(number))
    assert writer.wait_until_written(PATIENCE_S)
    assert writer.health().committed == 50
    writer.stop()
    assert rows(disk) == list(range(1, 51))


def test_a_file_system_that_turned_read_only_is_reported_and_outlasted(tmp_path, monkeypatch):
    """ext4 after an emergency remount: writes into the open journal and fsync succeed, statvfs tells."""
    path, writable = tmp_path / "s", os.statvfs(tmp_path)
    writer = StoreWriter(lambda: Store(path), 100, retry_s=0.01)
    writer.start()
    writer.submit(batch(1))
    assert writer.wait_until_written(PATIENCE_S)
    remounted = types.SimpleNamespace(f_flag=writable.f_flag | os.ST_RDONLY)
    monkeypatch.setattr(os, "statvfs", lambda _path: remounted)
    writer.submit(batch(2))
    wait_for(lambda: writer.health().failing, "a store that says that it fails")
    assert f"{path}: its file system has turned read-only" in writer.health().failing
    monkeypatch.undo()
    assert writer.wait_until_written(PATIENCE_S)
    assert writer.health().failing is None
    writer.stop()
    with Store(path) as store:
        assert [row.number for row in store.seconds()] == [1, 2]


def test_a_failing_disk_is_outlasted(disk):
    writer = StoreWriter(disk.open, 100, retry_s=0.01)
    disk.broken.set()
    writer.start()
    for number in range(1, 21):
        writer.submit(batch(number))
    for _ in range(3):
        assert disk.refusals.acquire(timeout=PATIENCE_S)
    assert "disk I/O error" in writer.health().failing
    assert writer.health().pending == 20
    disk.broken.clear()
    assert writer.wait_until_written(PATIENCE_S)
    assert writer.health().failing is None
    writer.stop()
    assert rows(disk) == list(range(1, 21))


def test_too_many_waiting_give_up_records_but_not_totals(disk):
    writer = StoreWriter(disk.open, 5, retry_s=60.0)
    disk.broken.set()
    writer.start()
    ticket = Ticket(1.0, 1, 1, 9.0, 10.0)
    writer.submit(batch(1, tickets=(ticket,)))
    for number in range(2, 21):
        writer.submit(batch(number))
    assert disk.refusals.acquire(timeout=PATIENCE_S)
    assert writer.health().records_dropped == 15
    disk.broken.clear()
    writer.stop()
    assert rows(disk) == list(range(16, 21))
    with Store(disk.path) as store:
        assert store.state() == {"total_mass_kg": 200.0}
        assert store.loads()[0].mass_kg == 200.0
        assert store.tickets() == [ticket]


def test_a_long_failure_keeps_one_row_of_a_load(disk):
    """A load that is open for hours is in every second's batch."""
    committed: list[Batch] = []

    class Recording(Store):
        def commit(self, batches: Sequence[Batch]) -> None:
            committed.extend(batches)
            super().commit(batches)

    writer = StoreWriter(lambda: Recording(disk.path), 5)
    for number in range(1, 101):
        writer.submit(batch(number))
    writer.start()
    writer.stop()
    assert [len(waiting.loads) for waiting in committed] == [1] * 5
    assert committed[0].loads == batch(96).loads
    with Store(disk.path) as store:
        assert store.loads() == list(batch(100).loads)


def test_stopping_tries_once_more(disk):
    writer = StoreWriter(disk.open, 100, retry_s=60.0)
    disk.broken.set()
    writer.start()
    writer.submit(batch(1))
    assert disk.refusals.acquire(timeout=PATIENCE_S)
    disk.broken.clear()
    writer.stop()
    assert rows(disk) == [1]


def test_stopping_does_not_wait_for_a_disk_that_stays_broken(disk):
    writer = StoreWriter(disk.open, 100, retry_s=60.0)
    disk.broken.set()
    writer.start()
    writer.submit(batch(1))
    assert disk.refusals.acquire(timeout=PATIENCE_S)
    writer.stop()
    assert not writer.alive
    assert rows(disk) == []


def test_a_batch_that_no_store_takes_is_left_out_and_counted(disk):
    writer = StoreWriter(disk.open, 100)
    for number in range(1, 6):
        writer.submit(batch(number, state={"zero_mv": float("nan")}) if number == 3 else batch(number))
    writer.start()
    assert writer.wait_until_written(PATIENCE_S)
    assert writer.health().batches_refused == 1
    writer.stop()
    assert rows(disk) == [1, 2, 4, 5]


@pytest.fixture
def clock_s(monkeypatch) -> list[float]:
    """The writer's monotonic clock, to be set."""
    time_s = [100.0]
    monkeypatch.setattr("yieldmon.service.writer.monotonic", lambda: time_s[0])
    return time_s


def test_waiting_is_counted_from_the_first_that_waits(disk, clock_s):
    writer = StoreWriter(disk.open, 100)
    assert writer.health().waiting_s == 0.0
    writer.submit(batch(1))
    clock_s[0] = 103.0
    writer.submit(batch(2))
    assert writer.health().waiting_s == 3.0
    writer.start()
    assert writer.wait_until_written(PATIENCE_S)
    assert writer.health().waiting_s == 0.0
    clock_s[0] = 200.0
    writer.submit(batch(3))
    assert writer.health().waiting_s == 0.0
    writer.stop()


def test_a_write_that_ends_begins_the_waiting_anew(disk, clock_s, monkeypatch):
    """A disk that takes long over each batch, but takes them, is not one that takes none."""
    gate, at_the_gate = threading.Semaphore(0), threading.Semaphore(0)
    commit = Store.commit

    def slow(store, batches):
        at_the_gate.release()
        assert gate.acquire(timeout=PATIENCE_S)
        commit(store, batches)

    monkeypatch.setattr(Store, "commit", slow)
    writer = StoreWriter(disk.open, 100)
    writer.start()
    writer.submit(batch(1))
    assert at_the_gate.acquire(timeout=PATIENCE_S)
    writer.submit(batch(2))
    clock_s[0] = 108.0
    assert writer.health().waiting_s == 8.0
    gate.release()
    assert at_the_gate.acquire(timeout=PATIENCE_S)
    assert writer.health().pending == 1
    assert writer.health().waiting_s == 0.0
    gate.release()
    writer.stop()


def test_room_is_made_once_a_minute(disk, monkeypatch):
    rounds = []
    monkeypatch.setattr(Store, "prune", lambda store: rounds.append(store.last_batch()))
    writer = StoreWriter(disk.open, 100)
    writer.start()
    for number in range(1, 131):
        writer.submit(batch(number))
        assert writer.wait_until_written(PATIENCE_S)
    writer.stop()
    assert rounds == [60, 120]
