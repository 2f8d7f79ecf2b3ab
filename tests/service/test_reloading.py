"""A configuration on a disk that hangs: it is read beside the engine, and given up after a while."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from tests.service.bench import PATIENCE_S, running, wait_for, warm_up
from yieldmon.errors import InputError
from yieldmon.service import reloading
from yieldmon.service.config import configuration
from yieldmon.service.reloading import Reloading
from yieldmon.service.timeouts import Timeouts


class HangingDisk:
    """Every configuration that is read from now on waits until the disk is released; `waiting` of them do."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.released = threading.Event()
        self.waiting = 0
        read = configuration.load

        def load(*how: Path) -> configuration.Configuration:
            self.waiting += not self.released.is_set()
            assert self.released.wait(PATIENCE_S)
            return read(*how)

        monkeypatch.setattr(configuration, "load", load)


def test_measuring_goes_on_while_a_configuration_is_read(tmp_path, monkeypatch):
    with running(tmp_path) as bench:
        disk = HangingDisk(monkeypatch)
        try:
            bench.daemon.request_reload()
            wait_for(lambda: disk.waiting, "the reading")
            bench.play(4, 0.0)
            bench.played()
            assert bench.status["configuration"]["reload"] == "none since the start"
            # What is written after the reading began is for the next one.
            bench.daemon.request_reload()
        finally:
            disk.released.set()
        wait_for(lambda: bench.status["configuration"]["reloads"] == 2, "both reloads")
        assert bench.status["configuration"]["reload"] == "taken"


def test_a_zero_is_refused_in_grain_also_before_the_first_second_after_a_reload(tmp_path: Path) -> None:
    with running(tmp_path) as bench:
        warm_up(bench)
        for number in (1, 2):
            bench.daemon.request_reload()
            wait_for(lambda number=number: bench.status["configuration"]["reloads"] == number, "the reload")
            with pytest.raises(InputError, match="zero: there is grain: the paddle pulses have an amplitude of"):
                bench.daemon.command({"command": "zero"})


def test_a_configuration_that_cannot_be_read_in_time_is_refused(tmp_path, monkeypatch, caplog):
    """Each time anew, and without a thread for each of any number of tries."""
    with running(tmp_path, reload_s=0.05) as bench:
        disk = HangingDisk(monkeypatch)
        notes = []
        try:
            for number in range(1, 6):
                bench.daemon.request_reload()
                wait_for(lambda number=number: bench.status["configuration"]["reloads"] == number, "the refusal")
                notes.append(bench.status["configuration"]["reload"])
            bench.play(4, 0.0)
            bench.played()
        finally:
            disk.released.set()
        assert disk.waiting == 3
        late = "refused: reload: the configuration could not be read within 0.05 s; expected a disk that answers"
        assert notes == [late] * 3 + ["refused: reload: 3 earlier ones still wait for the disk; expected a disk that answers"] * 2
        assert f"reload {late.replace(':', ', the old configuration stays in use:', 1)}" in caplog.text
        wait_for(lambda: not any(thread.name == "reload" for thread in threading.enumerate()), "the disk's answers")
    with running(tmp_path) as bench:
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reload"] == "taken", "the reload once the disk answers")


def test_an_error_that_was_not_foreseen_ends_no_measuring(tmp_path, monkeypatch, caplog):
    def load(*_: Path) -> configuration.Configuration:
        raise ZeroDivisionError("a defect")

    with running(tmp_path) as bench:
        monkeypatch.setattr(configuration, "load", load)
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reloads"] == 1, "the refusal")
        assert bench.status["configuration"]["reload"] == "refused: reload: ZeroDivisionError: a defect"
        bench.play(3, 0.0)
        bench.played()
    assert "Traceback" in caplog.text


@pytest.mark.parametrize(("later_s", "due"), [(20.0, False), (20.0 + 1 / 1024, True)])
def test_a_reading_may_take_twenty_seconds(later_s, due, monkeypatch):
    now_s = 100.0
    monkeypatch.setattr(reloading, "monotonic", lambda: now_s)
    released = threading.Event()
    of_disk = Reloading(lambda: released.wait(PATIENCE_S), limit_s=Timeouts().reload_s)
    assert (of_disk.under_way, of_disk.due) == (False, False)
    of_disk.begin()
    now_s += later_s
    assert (of_disk.under_way, of_disk.due) == (True, due)
    if due:
        of_disk.take(lambda new: ())
        assert of_disk.note.startswith("refused: reload: the configuration could not be read within 20 s")
        assert (of_disk.under_way, of_disk.due) == (False, False)
    released.set()


def test_three_readings_may_hang_at_once():
    released = threading.Event()
    of_disk = Reloading(lambda: released.wait(PATIENCE_S), limit_s=-1.0)
    for _ in range(3):
        of_disk.begin()
        of_disk.take(lambda new: ())
        assert "could not be read" in of_disk.note
    of_disk.begin()
    assert of_disk.due
    of_disk.take(lambda new: ())
    assert (of_disk.count, "3 earlier ones still wait for the disk" in of_disk.note) == (4, True)
    released.set()


def test_without_a_file_there_is_nothing_to_read():
    nothing = Reloading(None, limit_s=PATIENCE_S)
    nothing.begin()
    wait_for(lambda: nothing.due, "the answer")
    nothing.take(lambda new: ())
    assert "this run has no configuration file" in nothing.note
