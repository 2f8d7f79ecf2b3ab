"""Workers of this machine are forked from one process: what becomes of a run when one of them, or that process, is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from tests.fleet.logs import dataset_files, tree
from tests.fleet.runs import tasks
from yieldmon.fleet.dataset_files import MARK
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


def forks(process: psutil.Process) -> bool:
    """Whether it is one that workers are forked from."""
    try:
        return "forkserver" in " ".join(process.cmdline())
    except psutil.Error:
        return False


def marks(folder: Path) -> int:
    """How many days are finished."""
    return len(list(folder.rglob(MARK)))


def first_of(found: Callable[[], list[psutil.Process]]) -> psutil.Process:
    """The first process, as soon as there is one."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        if processes := found():
            return processes[0]
        time.sleep(0.01)
    raise AssertionError("no such process was begun")


@contextmanager
def begun(source: Path, out: Path) -> Iterator[subprocess.Popen[str]]:
    """A run of two workers; what is left of it ends with the test."""
    command = [sys.executable, "-m", "yieldmon", "fleet", "run", str(source), "--out", str(out), "--workers", "2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True) as program:
        try:
            yield program
        except BaseException:
            os.killpg(program.pid, signal.SIGKILL)
            raise


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
    with begun(source, tmp_path / "out") as program:
        victim = first_of(lambda: victims(psutil.Process(program.pid)) if marks(tmp_path) >= days_done else [])
        victim.kill()
        _, said = program.communicate(timeout=PATIENCE_S)
    assert program.returncode == 0, said
    assert days(tmp_path / "out") == due


def test_a_run_whose_workers_cannot_be_forked_again_starts_others(source: Path, due: dict[str, bytes], tmp_path: Path) -> None:
    """Killed, the process that they are forked from begins anew; killed again before it has one, no worker is left."""
    with begun(source, tmp_path / "out") as program:
        run = psutil.Process(program.pid)
        first = first_of(lambda: server(run))
        first.kill()
        first_of(lambda: [child for child in run.children() if child != first and forks(child)]).kill()
        _, said = program.communicate(timeout=PATIENCE_S)
    assert program.returncode == 0, said
    assert days(tmp_path / "out") == due
