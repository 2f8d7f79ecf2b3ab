"""The store's thread: order, retries, giving up records but never totals."""

from __future__ import annotations

import os
import threading
import types
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from tests.service.bench import wait_for
from tests.service.test_store import batch, second
from yieldmon.service.storage.batch import Action, Batch, FaultEvent, ParameterVersion, Step, SweepRecord, Ticket
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreError
from yieldmon.service.storage.writer import StoreWriter

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


def test_of_what_waits_too_long_only_the_records_are_dropped(disk):
    """Rows of every other kind, each second one of each; of a counter the newest value of the last batch that has it."""
    writer = StoreWriter(disk.open, 3)
    for number in range(1, 13):
        now_s = 1.7e9 + number
        writer.submit(
            batch(
                number, sweeps=(SweepRecord(now_s, "UPDATED", "", {}),),
                parameter_versions=(ParameterVersion(number, now_s, "", {}),), faults=(FaultEvent(now_s, "FRAMES_LOST", True),),
                tickets=(Ticket(now_s, number, number, 9000.0, 9100.0),),
                actions=(Action(number, now_s, "zero", "", {}),), steps=(Step(number, now_s, {}),),
                counters={"samples_lost": number, f"only_in_{number}": 1},
            )
        )  # fmt: skip
    writer.start()
    writer.stop()
    assert writer.health().records_dropped == 9
    times = [1.7e9 + number for number in range(1, 13)]
    with Store(disk.path) as store:
        assert [row.number for row in store.seconds()] == [10, 11, 12]
        for kept in (store.sweeps(), store.parameter_versions(), store.faults(), store.tickets(), store.actions(), store.steps()):
            assert [row.time_s for row in kept] == times
        assert store.counters() == {"samples_lost": 12, **{f"only_in_{number}": 1 for number in range(1, 13)}}
        assert store.state() == batch(12).state


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


TICKET = Ticket(1.7e9, 1, 1, 9.0, 10.0, "third")
ACTION = Action(1, 1.7e9, "zero", "someone", {"second": 3})
SWEEP = SweepRecord(1.7e9, "updated", "", {"sweep_id": 1})
VERSION = ParameterVersion(2, 1.7e9, "file", {"values": {}})
STEP = Step(2, 1.7e9, {"before": 1})
FAULT = FaultEvent(1.7e9, "FramesLost", active=True)
NAN = float("nan")
#: What a batch may bring that breaks the schema, and what is said of it.
REFUSED = [
    ({"state": {"zero_mv": NAN}}, "the monitor's state: "),
    ({"state": {"zero_mv": object()}}, "the monitor's state: "),
    ({"seconds": (second(3, time_s=NAN),)}, "second 3: "),
    ({"seconds": (second(3), second(3))}, "second 3: "),
    ({"loads": (replace(batch(3).loads[0], mass_kg=NAN),)}, "load 1: "),
    ({"loads": (replace(batch(3).loads[0], field=object()),)}, "load 1: "),
    ({"sweeps": (SWEEP, replace(SWEEP, document={"angle": NAN}))}, "a sweep that ended as updated: "),
    ({"parameter_versions": (VERSION, replace(VERSION, version=10**30))}, f"parameter version {10**30}: "),
    ({"faults": (FAULT, replace(FAULT, detail="\udc80"))}, "fault FramesLost: "),
    ({"tickets": (TICKET, Ticket(1.7e9, 2, 1, 9.0, 10.0))}, "ticket for load 2: "),
    ({"actions": (ACTION, replace(ACTION, number=2, document={"x": {1}}))}, "action 2 (zero): "),
    ({"steps": (STEP, replace(STEP, version=3, document={"x": NAN}))}, "step to version 3: "),
    ({"counters": {"received": 7, "huge": 10**30}}, "counter huge: "),
]


@pytest.mark.parametrize(("brings", "says"), REFUSED, ids=[says for _, says in REFUSED])
def test_a_row_that_no_store_takes_is_left_out_alone(disk, caplog, brings, says):
    """All else of its second is stored: a ticket that was answered is not lost for a second that makes no sense."""
    sound = {
        "tickets": (TICKET,), "actions": (ACTION,), "sweeps": (SWEEP,), "parameter_versions": (VERSION,), "steps": (STEP,),
        "faults": (FAULT,), "counters": {"received": 7},
    }  # fmt: skip
    writer = StoreWriter(disk.open, 100)
    for number in range(1, 6):
        writer.submit(batch(number, **{**sound, **brings}) if number == 3 else batch(number))
    writer.start()
    assert writer.wait_until_written(PATIENCE_S)
    health = writer.health()
    writer.stop()
    assert (health.batches_refused, health.committed, health.failing, health.replacements) == (1, 5, None, 0)
    assert [record.message for record in caplog.records if says in record.message and "left out" in record.message]
    with Store(disk.path) as store:
        assert [row.number for row in store.seconds() if row.number != 3] == [1, 2, 4, 5]
        assert (3 in {row.number for row in store.seconds()}) is (brings != REFUSED[2][0])
        assert (store.tickets(), store.actions(), store.sweeps()) == ([TICKET], [ACTION], [SWEEP])
        assert (store.parameter_versions(), store.steps(), store.faults()) == ([VERSION], [STEP], [FAULT])
        assert store.counters() == {"received": 7}
        assert (store.last_batch(), store.state()) == (5, {"total_mass_kg": 50.0})
        assert [load.mass_kg for load in store.loads()] == [50.0]


def test_a_state_that_no_store_takes_leaves_the_one_before_it(disk):
    """The last batch before a stop: commits are counted on, and the second's totals are newer than the state's."""
    writer = StoreWriter(disk.open, 100)
    writer.start()
    writer.submit(batch(1))
    writer.submit(batch(2, state={"zero_mv": NAN}))
    assert writer.wait_until_written(PATIENCE_S)
    writer.stop()
    with Store(disk.path) as store:
        assert (store.last_batch(), store.state(), store.last_second().total_kg) == (2, {"total_mass_kg": 10.0}, 20.0)
    again = StoreWriter(disk.open, 100)
    again.expect(2)
    again.start()
    again.submit(batch(3))
    assert again.wait_until_written(PATIENCE_S)
    assert (again.health().replacements, again.health().batches_refused) == (0, 0)
    again.stop()
    assert rows(disk) == [1, 2, 3]


def test_a_disk_that_fails_behind_a_refused_batch_keeps_what_waits(disk):
    """What was written before the failure is written once, and counted."""
    broken_from = []

    class Failing(Store):
        def commit(self, batches):
            if broken_from and batches[0].number >= broken_from[0] and len(batches) == 1:
                raise StoreError(f"{disk.path}: disk I/O error")
            super().commit(batches)

    writer = StoreWriter(lambda: Failing(disk.path), 100, retry_s=0.01)
    broken_from.append(4)
    for number in range(1, 6):
        writer.submit(batch(number, counters={"huge": 10**30}) if number == 2 else batch(number))
    writer.start()
    wait_for(lambda: writer.health().committed == 3, "the three before the failure")
    assert (writer.health().batches_refused, writer.health().pending) == (1, 2)
    broken_from.clear()
    assert writer.wait_until_written(PATIENCE_S)
    assert (writer.health().batches_refused, writer.health().committed) == (1, 5)
    writer.stop()
    assert rows(disk) == [1, 2, 3, 4, 5]


@pytest.fixture
def clock_s(monkeypatch) -> list[float]:
    """The writer's monotonic clock, to be set."""
    time_s = [100.0]
    monkeypatch.setattr("yieldmon.service.storage.writer.monotonic", lambda: time_s[0])
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
