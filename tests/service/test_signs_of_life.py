"""Threads that hang, signals in bursts, stops that must not take for ever, files that vanish under a running daemon."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import can
import pytest

from tests.service.bench import PATIENCE_S, Bench, running, wait_for
from yieldmon.service import metrics, rate_limited_log
from yieldmon.service.history.journal import Journal
from yieldmon.service.storage.store import Store
from yieldmon.service.timeouts import Timeouts
from yieldmon.service.traffic.transmit import Transmitter


def test_a_transmit_thread_that_hangs_is_seen_and_stops_nothing():
    gate, begun, now_s = threading.Event(), threading.Event(), [0.0]

    def send(message: can.Message, timeout: float) -> None:
        begun.set()
        gate.wait(PATIENCE_S)

    transmitter = Transmitter(send, 10, 0.5, clock=lambda: now_s[0])
    transmitter.start()
    assert transmitter.hangs_s() == 0.0
    transmitter.submit(can.Message())
    assert begun.wait(PATIENCE_S), "the send that hangs"
    now_s[0] = 9.0
    assert transmitter.hangs_s() == 9.0
    assert not transmitter.stop(0.05), "it does not end, and the stop does not wait for it"
    gate.set()
    wait_for(lambda: not transmitter.alive, "its end")


def test_frames_that_wait_too_long_are_late_for_a_while():
    now_s = [0.0]
    transmitter = Transmitter(lambda message, timeout: None, 1, 0.5, clock=lambda: now_s[0])
    transmitter.submit(can.Message())
    transmitter.submit(can.Message())
    assert transmitter.counters().late == 1
    assert transmitter.counters().late_now(1.0)
    assert not transmitter.counters().late_now(3.0)


def test_a_hanging_send_is_a_fault_and_the_daemon_stops_all_the_same(tmp_path: Path):
    gate = threading.Event()
    with running(tmp_path) as bench:
        bench.play(3, 0.0)
        bench.played()
        bench.daemon.receiver.bus.send = lambda message, timeout=None: gate.wait(PATIENCE_S) and None
        bench.play(2, 0.0)
        wait_for(lambda: bench.daemon.transmitter.hangs_s() > 2.1, "the hang")
        bench.play(2, 0.0)
        wait_for(lambda: "BusError" in bench.faults, "the fault")
        assert "the transmit thread hangs" in bench.faults["BusError"]
    gate.set()


@pytest.mark.parametrize("name", ["transmitter", "writer", "receiver"])
def test_a_dead_thread_ends_the_daemon(tmp_path: Path, name: str):

    def live() -> None:
        with running(tmp_path) as bench:
            getattr(bench.daemon, name).stop()
            ended(bench)

    with pytest.raises(RuntimeError, match="thread has died"):
        live()


def ended(bench: Bench) -> None:
    """The daemon ends by itself."""
    assert bench.thread is not None
    bench.thread.join(PATIENCE_S)
    assert not bench.thread.is_alive()


def test_an_exception_in_the_journal_ends_the_process_and_writes_what_there_is(tmp_path: Path, monkeypatch):
    def fail(*_: object) -> None:
        raise ArithmeticError("provoked")

    def live() -> None:
        with running(tmp_path) as bench:
            bench.play(4, 0.0)
            bench.played()
            monkeypatch.setattr(Journal, "batch", fail)
            bench.play(2, 0.0)
            ended(bench)

    with pytest.raises(ArithmeticError, match="provoked"):
        live()
    assert not any(thread.name == "store-writer" and thread.is_alive() for thread in threading.enumerate())
    with Store(tmp_path / "yieldmon.sqlite") as store:
        assert len(store.seconds()) >= 3


def test_an_answer_states_its_age(tmp_path: Path, monkeypatch):
    later_s = [0.0]
    monkeypatch.setattr("yieldmon.service.daemon.monotonic", lambda: time.monotonic() + later_s[0])
    with running(tmp_path) as bench:
        bench.play(3, 0.0)
        bench.played()
        status = bench.daemon.command({"command": "status"})
        assert status["stale"] is (status["age_s"] > 5.0)
        later_s[0] = 60.0
        status = bench.daemon.command({"command": "status"})
        assert status["stale"] is True
        assert status["age_s"] >= 60.0
        written = "\n".join(metrics.lines(status))
    assert "yieldmon_status_stale 1" in written
    assert "yieldmon_status_age_seconds 6" in written
    assert "yieldmon_written_timestamp_seconds" in written


def test_signals_in_bursts_are_taken_between_any_two_instructions(tmp_path: Path):
    """Handlers on the thread that runs the daemon, as `yieldmon run` has it."""
    with running(tmp_path) as bench:
        daemon = bench.daemon
        before = signal.signal(signal.SIGHUP, lambda *_: daemon.request_reload())
        try:
            for _ in range(2000):
                os.kill(os.getpid(), signal.SIGHUP)
            wait_for(lambda: bench.status["configuration"]["reloads"] >= 1, "a reload")

            def measures() -> bool:
                """A reload that is still to come begins with no windows."""
                bench.play(1, 0.0)
                return len(bench.rows) >= 3

            wait_for(measures, "three windows")
        finally:
            signal.signal(signal.SIGHUP, before)
        assert bench.status["configuration"]["reloads"] <= 2000


@pytest.mark.parametrize("folder", [False, True], ids=["its files", "its folder"])
def test_a_store_that_is_removed_is_reported_and_written_anew_from_memory(tmp_path: Path, folder: bool):
    state = tmp_path / "state"
    state.mkdir()
    path = state / "yieldmon.sqlite"
    with running(tmp_path, state=state) as bench:
        bench.play(14, 0.0)
        bench.play(6, 60.0)
        bench.played()
        assert bench.daemon.writer.wait_until_written(PATIENCE_S)
        for file in state.glob("yieldmon.sqlite*"):
            if folder or not file.name.endswith(".lock"):
                file.unlink()
        if folder:
            state.rmdir()
        bench.play(3, 60.0)
        bench.played()
        wait_for(lambda: bench.daemon.writer.health().replacements == 1, "the replacement")
        bench.play(3, 60.0)
        bench.played()
        wait_for(lambda: "StoreFailing" in bench.faults, "the fault")
        assert "removed while in use" in bench.faults["StoreFailing"]
    with Store(path) as store:
        rows, loads, versions = store.seconds(), store.loads(), store.parameter_versions()
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    assert loads[-1].mass_kg == pytest.approx(rows[-1].load_kg)
    assert versions


def test_a_log_says_each_thing_a_few_times_a_minute():
    now_s = [0.0]
    quiet = rate_limited_log.RateLimitedLog(lambda: now_s[0])

    def records(count: int) -> list[bool]:
        import logging

        return [quiet.filter(logging.LogRecord("x", 30, "f.py", 7, "no room: %d", (n,), None)) for n in range(count)]

    assert sum(records(1000)) == 3
    now_s[0] = 61.0
    assert sum(records(1)) == 1
    now_s[0] = 62.0
    assert sum(records(10)) == 2


def test_a_writer_that_hangs_is_a_fault_and_loses_nothing(tmp_path: Path, monkeypatch):
    gate, hanging, ahead_s, commit, now_s = threading.Event(), threading.Event(), [0.0], Store.commit, time.monotonic

    def hang(store, batches):
        hanging.set()
        assert gate.wait(PATIENCE_S)
        commit(store, batches)

    monkeypatch.setattr("yieldmon.service.storage.writer.monotonic", lambda: now_s() + ahead_s[0])
    with running(tmp_path) as bench:
        bench.play(14, 0.0)
        bench.play(3, 60.0)
        bench.played()
        monkeypatch.setattr(Store, "commit", hang)
        bench.play(3, 60.0)
        bench.played()
        wait_for(lambda: bench.daemon.writer.health().pending >= 2, "batches that wait")
        assert hanging.wait(PATIENCE_S), "the commit's time counts from here"
        before_kg, ahead_s[0] = bench.status["total"]["mass_kg"], 11.0
        bench.play(3, 60.0)
        wait_for(lambda: "StoreFailing" in bench.faults, "the fault")
        assert "the disk is slow" in bench.faults["StoreFailing"]
        bench.played()
        assert bench.status["total"]["mass_kg"] > before_kg + 5.0
        gate.set()
        assert bench.daemon.writer.wait_until_written(PATIENCE_S)

        def over() -> bool:
            bench.play(1, 60.0)
            bench.played()
            return "StoreFailing" not in bench.faults

        wait_for(over, "the end of the fault")
    with Store(tmp_path / "yieldmon.sqlite") as store:
        rows = store.seconds()
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    assert sum(row.mass_kg for row in rows) == pytest.approx(rows[-1].total_kg)


def test_the_time_limit_of_a_stop_is_kept_by_a_disk_that_hangs(tmp_path: Path, monkeypatch):
    gate = threading.Event()
    commit = Store.commit

    def hang(store, batches):
        gate.wait(PATIENCE_S)
        commit(store, batches)

    with running(tmp_path, stop_s=Timeouts().stop_s) as bench:
        bench.play(2, 0.0)
        bench.played()
        monkeypatch.setattr(Store, "commit", hang)
        bench.play(2, 0.0)
        bench.played()
        bench.daemon.request_stop()
        assert bench.thread is not None
        bench.thread.join(PATIENCE_S / 2.0)
        assert not bench.thread.is_alive(), "the disk lets go after PATIENCE_S only"
        gate.set()
