"""Workers of this machine are forked from one process: what becomes of a run when one of them, or that process, is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from tests.fleet.logs import dataset_files, tree
from tests.fleet.runs import tasks
from yieldmon.fleet.dataset import MARK
from yieldmon.fleet.worker import work

PATIENCE_S = 60.0


def workers(run: psutil.Process) -> list[psutil.Process]:
    """Those that are there: the children of the run's children."""
    return [worker for server in run.children() for worker in server.children()]


def server(run: psutil.Process) -> list[psutil.Process]:
    """The process that they are forked from."""
    return [child for child in run.children() if child.children()]


def days(folder: Path) -> dict[str, bytes]:
    """What a dataset holds of machines and days."""
    return {name: content for name, content in dataset_files(folder).items() if name.startswith("machine=")}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tree(tmp_path_factory.mktemp("forked") / "tree", machines=2, days=3)


@pytest.fixture(scope="module")
def due(source: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What a run that nothing befalls leaves."""
    whole = tmp_path_factory.mktemp("whole")
    for task in tasks(source, whole):
        work(task)
    return days(whole)


@pytest.mark.parametrize(
    "days_done",
    [
        pytest.param(0, id="as soon as there is one"),
        pytest.param(1, id="after a day", marks=pytest.mark.slow),  # the end waits for Dask's patience with the dead
    ],
)
@pytest.mark.parametrize("victims", [workers, server], ids=["a worker", "the process that they are forked from"])
def test_a_killed_one_costs_no_day(
    source: Path, due: dict[str, bytes], tmp_path: Path, victims: Callable[[psutil.Process], list[psutil.Process]], days_done: int
) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "yieldmon", "fleet", "run", str(source), "--out", str(out), "--workers", "2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True) as program:
        run, end_s, found = psutil.Process(program.pid), time.monotonic() + PATIENCE_S, []
        try:
            while not found and program.poll() is None and time.monotonic() < end_s:
                time.sleep(0.01)
                found = victims(run) if len(list(out.rglob(MARK))) >= days_done else []
            assert found, "no worker was begun"
            found[0].kill()
            _, said = program.communicate(timeout=PATIENCE_S)
        except BaseException:
            os.killpg(program.pid, signal.SIGKILL)
            raise
    assert program.returncode == 0, said
    assert days(out) == due
