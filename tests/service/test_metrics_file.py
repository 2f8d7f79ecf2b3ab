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
    assert "m.prom: the disk hangs; the file stays" in caplog.text
    assert path.exists()
    answers.set()
    for thread in threading.enumerate():
        if thread.name == "metrics":
            thread.join(120.0)
    assert not path.exists()
