"""Threads beside the measuring: those that die or hang are restarted, and what they do goes on."""

from __future__ import annotations

import selectors
import threading
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.service.bench import PATIENCE_S, Bench, running, wait_for
from yieldmon.files import parameter_file
from yieldmon.files.machine_file import load as load_machine
from yieldmon.service import metrics, supervision
from yieldmon.service.history.remeasuring_thread import RemeasuringJob, RemeasuringThread
from yieldmon.service.operator import command_loads, control
from yieldmon.service.operator.control import ControlServer
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.service.supervision import HANGS_LOOKS, HANGS_S, MOST, Supervisor


class Helper:
    """What a supervisor sees. restarts: how often it was restarted."""

    def __init__(self) -> None:
        self.alive, self.busy_since_s, self.restarts = True, None, 0

    def restart(self) -> None:
        self.restarts += 1
        self.alive = True


def looked(helper: Helper, times_s: Iterator[float]) -> int:
    supervisor = Supervisor("test", helper)
    for now_s in times_s:
        supervisor.look(now_s)
    return helper.restarts


def test_a_helper_that_lives_is_left_alone() -> None:
    helper = Helper()
    assert looked(helper, iter(range(1000))) == 0, "one that waits"

    def rounds() -> Iterator[float]:
        for now_s in range(1000):
            helper.busy_since_s = now_s - now_s % 3
            yield now_s

    assert looked(helper, rounds()) == 0, "one that is busy with one thing after another"


def test_a_process_that_was_stopped_has_no_helper_that_hangs() -> None:
    """All threads look as if they hung, at the first look after it."""
    helper = Helper()

    def times() -> Iterator[float]:
        for now_s in (0.0, 1.0, 10 * HANGS_S, 10 * HANGS_S + 1.0):
            yield now_s
            helper.busy_since_s = 1.0 if now_s < 2.0 else now_s

    assert looked(helper, times()) == 0


@pytest.mark.parametrize("dies", [True, False])
def test_a_helper_that_dies_or_hangs_is_restarted_some_times(dies: bool, caplog: pytest.LogCaptureFixture) -> None:
    helper = Helper()
    helper.busy_since_s = 0.0

    def times() -> Iterator[float]:
        for number in range(2 * MOST * HANGS_LOOKS):
            helper.alive = not dies
            yield 1.1 * number * HANGS_S / HANGS_LOOKS

    assert looked(helper, times()) == 5 == MOST, "as the page of what happens says"
    assert f"the test thread {'has died' if dies else 'hangs'}; restarted" in caplog.text
    assert "for the last time in this run" in caplog.text


class _Selector(selectors.DefaultSelector):
    """Of a thread that is ended, or held up, in its next round."""

    gate = threading.Event()
    how = ""

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if threading.current_thread().name == "control":
            how, _Selector.how = _Selector.how, ""
            if how == "dies":
                raise SystemExit
            if how == "hangs":
                _Selector.gate.wait(PATIENCE_S)
        return super().select(timeout)


def answers(bench: Bench, path: Path) -> bool:
    bench.play(1, 0.0)
    bench.played()
    with suppress(ControlError):
        return bool(ask(path, {"command": "status"}, 0.5)["version"])
    return False


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("how", ["dies", "hangs"])
def test_status_is_answered_again_after_the_thread_that_does(
    tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(control.selectors, "DefaultSelector", _Selector)
    monkeypatch.setattr(supervision, "HANGS_S", 2.0)
    with running(tmp_path) as bench:
        path = tmp_path / "yieldmon.sock"
        bench.play(2, 0.0)
        wait_for(lambda: answers(bench, path), "the first answer")
        _Selector.how, _Selector.gate = how, threading.Event()
        wait_for(lambda: not _Selector.how, "the trouble")

        def said() -> bool:
            bench.play(1, 0.0)
            bench.played()
            return f"the control thread {'has died' if how == 'dies' else 'hangs'}" in caplog.text

        wait_for(said, "the line")
        wait_for(lambda: answers(bench, path), "an answer")
    # A thread that goes on only after the daemon's end makes no socket that nobody would take away.
    _Selector.gate.set()
    wait_for(lambda: all(thread.name != "control" for thread in threading.enumerate()), "the threads' end")
    assert not path.exists()


def test_a_listening_socket_that_fails_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A descriptor that somebody closed."""
    fails = threading.Event()

    class Failing(selectors.DefaultSelector):
        def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
            if fails.is_set():
                fails.clear()
                for key in list(self.get_map().values()):
                    key.fileobj.close()  # type: ignore[union-attr]
                raise OSError(9, "Bad file descriptor")
            return super().select(timeout)

    monkeypatch.setattr(control.selectors, "DefaultSelector", Failing)
    path = tmp_path / "s.sock"
    server = ControlServer(path, None, lambda request: {"fine": True})
    server.start()
    fails.set()
    wait_for(lambda: not fails.is_set(), "the failure")

    def fine() -> bool:
        with suppress(ControlError):
            return bool(ask(path, {"command": "x"}, 1.0)["fine"])
        return False

    wait_for(fine, "an answer")
    server.stop()
    assert not path.exists()


def test_a_stop_does_not_wait_for_the_next_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Patient(selectors.DefaultSelector):
        def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
            return super().select(3600.0)

    monkeypatch.setattr(control.selectors, "DefaultSelector", Patient)
    server = ControlServer(tmp_path / "s.sock", None, lambda request: {"fine": True})
    server.start()
    assert ask(server.path, {"command": "x"})["fine"]
    server.stop()
    wait_for(lambda: not server.alive, "the thread's end")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_the_prometheus_file_is_written_again_after_a_thread_that_died(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write, dies, path = metrics.write, [True], tmp_path / "m.prom"

    def failing(where: Path, status: Mapping[str, Any]) -> None:
        if dies:
            dies.clear()
            raise SystemExit
        write(where, status)

    monkeypatch.setattr(metrics, "write", failing)
    with running(tmp_path, f"status: {{prometheus_file: {path}, prometheus_interval_s: 1}}") as bench:
        bench.play(2, 0.0)

        def written() -> bool:
            bench.play(1, 0.0)
            bench.played()
            return path.exists()

        wait_for(written, "the file")


def test_a_disk_that_holds_up_tickets_leaves_status_its_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = threading.Event()
    monkeypatch.setattr(command_loads, "of_new_ticket", lambda path, numbers: gate.wait(PATIENCE_S) and ())
    reported: list[str] = []

    def ticket() -> None:
        try:
            ask(tmp_path / "yieldmon.sock", {"command": "ticket", "first_load": 1, "mass_kg": 100.0}, PATIENCE_S)
        except ControlError as error:
            reported.append(str(error))

    with running(tmp_path) as bench:
        bench.play(2, 0.0)
        asking = [threading.Thread(target=ticket) for _ in range(8)]
        for thread in asking:
            thread.start()
        wait_for(lambda: len(reported) == 6, "those that the disk has no place for")
        assert set(reported) == {"the disk does not answer; nothing was done"}
        assert answers(bench, tmp_path / "yieldmon.sock")
        gate.set()
        for thread in asking:
            thread.join(PATIENCE_S)


def test_without_room_for_a_thread_no_load_is_measured_again_and_nothing_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    thread = RemeasuringThread(tmp_path / "s.sqlite", lambda _: True)
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", full)
        thread.start(load_machine(), RemeasuringJob((1,), parameter_file.load().version, None, 0.0))
    assert (thread.busy, thread.take()) == (False, None)
    assert "can't start new thread" in caplog.text
