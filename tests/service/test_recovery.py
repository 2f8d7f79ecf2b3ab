"""What goes wrong around a measuring daemon in a season: clocks, disks, files, and a second daemon."""

from __future__ import annotations

import sqlite3
from itertools import pairwise
from pathlib import Path

import can
import pytest

from tests.service.bench import (
    CODEC,
    EMPTY_MV,
    GRAIN_MV,
    START_S,
    UNHURRIED,
    Bench,
    running,
    traffic,
    wait_for,
    warm_up,
)
from yieldmon import frames
from yieldmon.errors import InputError
from yieldmon.service.config import configuration
from yieldmon.service.daemon import Daemon
from yieldmon.service.history.recovery import recover
from yieldmon.service.storage.ownership import Ownership
from yieldmon.service.storage.retention import DEFAULT_RETENTION
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreError


def daemon_on(folder: Path, text: str = "") -> Daemon:
    path = folder / "other.yaml"
    path.write_text(text)
    environment = {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    bus = can.Bus(interface="virtual", channel=f"other {folder}")
    return Daemon(configuration.load(path, environment), environment=environment, bus_factory=lambda: bus)


@pytest.mark.parametrize("step_s", [3 * 3600.0, -3 * 3600.0, -1.5, 90.0], ids=["forward", "back", "a little back", "a gap"])
def test_a_clock_that_is_set_mid_load_changes_no_mass(tmp_path, step_s):
    """The windows go on at their pace: no hours of empty ones, none twice, and the load counts what was measured."""
    with running(tmp_path) as bench:
        warm_up(bench)
        bench.now_s += step_s
        bench.play(8, GRAIN_MV)
        wait_for(lambda: len(bench.rows) > 0 and bench.rows[-1]["number"] >= 26, "the windows after the step")
        shown = [row["faults"] for row in bench.rows]
    with Store(tmp_path / "yieldmon.sqlite") as store:
        rows, loads = store.seconds(), store.loads()
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    assert 26 <= len(rows) <= 28
    assert any("ClockJumped" in faults for faults in shown)
    # Time stands still for the frame at the step, so one window may miss its part.
    flows = [row.mass_kg for row in rows[20:26]]
    assert flows == pytest.approx([rows[18].mass_kg] * 6, rel=0.1)
    assert sum(row.mass_kg for row in rows) == pytest.approx(rows[-1].total_kg, rel=1e-12)
    assert sum(load.mass_kg for load in loads) == pytest.approx(rows[-1].total_kg, rel=1e-12)
    steps = [b.time_s - a.time_s for a, b in pairwise(rows[1:])]
    assert sorted(abs(step - 1.0) for step in steps)[-2] < 0.02, "one step of the clock, no drift beside it"


def test_a_second_daemon_on_the_same_store_is_refused(tmp_path):
    """It would number the seconds by itself; the first one goes on as if nothing had been."""
    with running(tmp_path) as bench:
        warm_up(bench)
        with pytest.raises(InputError, match=r"store\.path: .*yieldmon\.sqlite: another daemon is using it"):
            daemon_on(tmp_path, "status: {socket: other.sock}").run()
        bench.play(3, GRAIN_MV)
        bench.played()
        assert bench.faults == {}
    with Ownership(tmp_path / "yieldmon.sqlite"):
        pass


def test_a_second_daemon_on_the_same_socket_is_refused(tmp_path):
    with running(tmp_path) as bench:
        with pytest.raises(InputError, match=r"status\.socket: .*yieldmon\.sock: a daemon is running there"):
            daemon_on(tmp_path, "store: {path: other.sqlite}").run()
        assert bench.daemon.configuration.socket_path.exists(), "the running daemon keeps its socket"


def test_two_daemons_on_one_bus_both_say_so(tmp_path):
    """Each measures on; each sees the other's frames as a conflict."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    with running(tmp_path / "a") as first:
        first.play(5, EMPTY_MV)
        first.played()
        # Started later: its windows have other numbers.
        environment = {"STATE_DIRECTORY": str(tmp_path / "b"), "RUNTIME_DIRECTORY": str(tmp_path / "b")}
        loaded = configuration.load(tmp_path / "a" / "c.yaml", environment)
        second = Daemon(
            loaded,
            environment=environment,
            bus_factory=lambda: can.Bus(interface="virtual", channel=first.peer.channel_id),
            timeouts=UNHURRIED,
        )
        other = Bench(second, can.Bus(interface="virtual", channel="nobody listens"))
        other.start()

        def said_by(bench: Bench) -> bool:
            first.play(2, EMPTY_MV)
            first.played()
            return "OutputConflict" in bench.faults

        try:
            wait_for(lambda: said_by(first), "the first's fault")
            wait_for(lambda: said_by(other), "the second's fault")
        finally:
            other.stop()


def test_a_medium_that_takes_no_writing_is_read_and_measuring_goes_on(tmp_path, monkeypatch):
    """As SQLite finds it on a file system mounted read-only: neither the file for writing nor a journal beside it."""
    with running(tmp_path) as bench:
        warm_up(bench)
        before_kg = bench.status["total"]["mass_kg"]

    def refuse(store: Store) -> None:
        raise sqlite3.OperationalError("unable to open database file")

    monkeypatch.setattr(Store, "_prepare", refuse)
    with running(tmp_path, start_s=START_S + 60.0, retry_s=0.05) as bench:
        assert bench.status["total"]["mass_kg"] == pytest.approx(before_kg, abs=10.0)
        bench.play(2, GRAIN_MV)
        wait_for(lambda: bench.daemon.writer.health().failing, "the failing to be noticed")
        bench.play(3, GRAIN_MV)
        wait_for(lambda: "StoreFailing" in bench.faults, "StoreFailing")
        assert bench.rows[-1]["mass_flow_kg_s"] > 1.0, "the zero is remembered"
        monkeypatch.undo()
        wait_for(lambda: bench.daemon.writer.health().pending == 0, "what waited, written once the medium is back")
    with Store(tmp_path / "yieldmon.sqlite") as store:
        rows = store.seconds()
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    assert sum(row.mass_kg for row in rows) == pytest.approx(rows[-1].total_kg, rel=1e-12)


def no_room(store: Store) -> None:
    raise sqlite3.OperationalError("database or disk is full")


def test_a_store_that_cannot_be_read_at_all_is_reported_with_its_problem(tmp_path, monkeypatch, caplog):
    """Not by why the ways around that lead nowhere, and not taken for one that holds nothing."""
    path = tmp_path / "yieldmon.sqlite"
    with Store(path):
        pass

    def refuse(*_: object, **how: bool) -> Store:
        raise StoreError(f"{path}: " + ("schema version 0" if how else "database or disk is full"))

    monkeypatch.setattr("yieldmon.service.history.recovery.Store", refuse)
    with pytest.raises(StoreError, match=r"yieldmon\.sqlite: database or disk is full$"):
        recover(path, DEFAULT_RETENTION, refuse)
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == len(set(said)) == 2


@pytest.mark.parametrize("left", [None, b""], ids=["no file", "an empty file"])
def test_a_medium_that_is_full_before_there_is_a_store_does_not_stop_the_measuring(tmp_path, monkeypatch, left):
    path = tmp_path / "yieldmon.sqlite"
    if left is not None:
        path.write_bytes(left)
    monkeypatch.setattr(Store, "_prepare", no_room)
    with running(tmp_path, retry_s=0.05) as bench:
        warm_up(bench)
        wait_for(lambda: "StoreFailing" in bench.faults, "StoreFailing")
        assert bench.faults["StoreFailing"].endswith("database or disk is full")
        measured_kg = bench.status["total"]["mass_kg"]
        assert measured_kg > 1.0
        monkeypatch.undo()
        wait_for(lambda: bench.daemon.writer.health().pending == 0, "what waited, written once there is room")

        def mended() -> bool:
            bench.play(1, GRAIN_MV)
            bench.played()
            return "StoreFailing" not in bench.faults

        wait_for(mended, "no fault once there is room")
    with Store(path) as store:
        rows = store.seconds()
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    assert rows[-1].total_kg > measured_kg
    assert sum(row.mass_kg for row in rows) == pytest.approx(rows[-1].total_kg, rel=1e-12)


def test_a_store_with_a_journal_is_not_read_past_it(tmp_path):
    """The journal holds the last seconds; without them the total would run back."""
    path = tmp_path / "yieldmon.sqlite"
    with Store(path) as store:
        (tmp_path / "yieldmon.sqlite-wal.kept").write_bytes((tmp_path / "yieldmon.sqlite-wal").read_bytes())
        assert store.last_batch() == 0
    (tmp_path / "yieldmon.sqlite-wal.kept").rename(tmp_path / "yieldmon.sqlite-wal")
    with pytest.raises(StoreError, match="journal cannot be read"):
        Store(path, immutable=True)


def test_a_power_cut_mid_load_leaves_a_load_that_updates_nothing(tmp_path):
    """Seconds between the cut and the start are missing from its mass: the ticket corrects it and is no reference."""
    with running(tmp_path) as bench:
        warm_up(bench)
        number = bench.status["load"]["number"]
    with running(tmp_path, start_s=START_S + 60.0) as bench:
        bench.play(6, GRAIN_MV)
        bench.played()
        assert bench.status["load"]["number"] == number, "the load goes on"
        summary = next(load for load in bench.daemon.monitor.loads if load.number == number)
        assert not summary.complete
        bench.daemon.monitor.start_load()
        bench.play(3, GRAIN_MV)
        bench.played()
        newer = next(load for load in bench.daemon.monitor.loads if load.number == number + 1)
        assert newer.complete


def test_frames_of_hours_ago_in_one_go_do_not_flood_the_store(tmp_path):
    """Time stamps that swing to and fro by hours: each swing costs at most a window, not hours of them."""
    with running(tmp_path) as bench:
        for frame in traffic(START_S, 6.0, EMPTY_MV):
            swing_s = 7200.0 if int(frame.time_s * 10) % 2 else 0.0
            bench.peer.send(CODEC.encode(frame._replace(time_s=frame.time_s + swing_s)))
        wait_for(lambda: len(bench.rows) >= 4, "windows")
        wait_for(lambda: any(s["ClockJumped"] for s in bench.published(frames.YIELD_MONITOR_STATUS)), "ClockJumped")
        assert bench.rows[-1]["number"] <= 8
