"""What is taken away at a stop is the file that was written, and nothing else."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from yieldmon.service.metrics import MetricsFile


def no_status() -> Mapping[str, Any]:
    raise ValueError("not yet")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "m.prom"


def started_and_stopped(path: Path) -> None:
    metrics = MetricsFile(path, 3600.0, no_status)
    metrics.start()
    metrics.stop()


@pytest.mark.parametrize("alive", [True, False])
def test_the_file_goes_whether_or_not_its_thread_still_runs(path: Path, *, alive: bool) -> None:
    """A thread that has died takes nothing away."""
    path.write_text("stale")
    metrics = MetricsFile(path, 3600.0, no_status)
    if alive:
        metrics.start()
    else:
        assert not metrics.alive
    metrics.stop()
    assert not path.exists()
    assert not metrics.alive


def test_by_a_link_the_file_goes_and_the_link_stays(path: Path, tmp_path: Path) -> None:
    (tmp_path / "target").write_text("stale")
    path.symlink_to("target")
    started_and_stopped(path)
    assert path.is_symlink()
    assert not (tmp_path / "target").exists()


@pytest.mark.parametrize("plant", [os.mkfifo, os.mkdir, lambda path: path.symlink_to("/nonexistent/m")])
def test_what_is_no_file_stays(path: Path, plant) -> None:
    plant(path)
    started_and_stopped(path)
    assert os.path.lexists(path)


def test_a_disk_that_hangs_holds_up_no_stop(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path.write_text("stale")
    answers, unlink = threading.Event(), Path.unlink

    def hang(which: Path, missing_ok: bool = False) -> None:
        if which == path:
            assert answers.wait(120.0)
        unlink(which, missing_ok)

    monkeypatch.setattr(Path, "unlink", hang)
    started_and_stopped(path)
    assert "m.prom: the disk hangs; the file is left in place" in caplog.text
    assert path.exists()
    answers.set()
    for thread in threading.enumerate():
        if thread.name == "metrics":
            thread.join(120.0)
    assert not path.exists()


def some_status() -> Mapping[str, Any]:
    return {
        "windows": [], "faults": [], "load": {"mass_kg": 1.0}, "total": {"mass_kg": 2.0, "contested_mass_kg": 0.0},
        "bus": {"received": 0, "dropped": 0, "kernel_drops": 0, "sent": 0}, "store": {"pending": 0},
        "parameters": {"age_s": None}, "uptime_s": 1.0, "age_s": 0.1, "stale": False,
    }  # fmt: skip


@pytest.mark.parametrize("writers", [1, 2])
def test_a_file_that_two_daemons_write_is_reported(path: Path, caplog: pytest.LogCaptureFixture, writers: int) -> None:
    written = [threading.Semaphore(0) for _ in range(writers)]

    def counted(number: int) -> Mapping[str, Any]:
        written[number].release()
        return some_status()

    files = [MetricsFile(path, 0.01, lambda number=number: counted(number)) for number in range(writers)]
    for metrics in files:
        metrics.start()
    for times in written:
        assert all(times.acquire(timeout=30.0) for _ in range(20))
    for metrics in files:
        metrics.stop()
    reported = [record.getMessage() for record in caplog.records if "another process writes it too" in record.getMessage()]
    assert (len(reported) in (1, 2)) if writers == 2 else not reported
