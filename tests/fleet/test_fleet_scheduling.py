"""A scheduler that goes while a client asks it is waited for; what was answered is not asked again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

from tests.fleet import logs
from yieldmon.errors import InputError
from yieldmon.fleet import scheduling
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.identity import parameters_sha256, software
from yieldmon.fleet.partition import Partition
from yieldmon.fleet.scheduling import Cluster, run_all
from yieldmon.fleet.worker import DONE, FAILED, SKIPPED, Outcome, Task, work
from yieldmon.resources import shipped
from yieldmon.service.config import configuration


class Future:
    """Answered by a worker; fetching the answer may fail."""

    status = "finished"

    def __init__(self, name: str, harm: Exception | None) -> None:
        self._name, self._harm = name, harm

    def exception(self) -> None:
        """What the task raised."""

    def result(self) -> Outcome:
        """The answer."""
        if self._harm is not None:
            raise self._harm
        return Outcome(self._name, "done")

    def release(self) -> None:
        """Not needed any more."""


class Client:
    """Fetches the first answer; the next one finds the scheduler gone, once for each entry of `harms`."""

    harms: ClassVar[list[Exception]] = []
    submitted: ClassVar[list[str]] = []
    dashboard_link = ""
    cluster = None

    def __init__(self, address: str, timeout: int) -> None:
        self._harm = Client.harms.pop() if Client.harms else None
        self._asked = 0

    def submit(self, work: Any, task: Any, **how: Any) -> Future:
        """One more task."""
        self._asked += 1
        Client.submitted.append(task.partition.name)
        return Future(task.partition.name, self._harm if self._asked == 2 else None)

    def close(self, timeout: int) -> None:
        """The end."""


class Completed(list):
    """In the order of submission."""

    add = list.append


def tasks(count: int) -> list[Any]:
    return [SimpleNamespace(partition=Partition("m", f"d{n}", ()), token="t", dataset="season") for n in range(count)]


def cancelled(key: str, why: str) -> Exception:
    from distributed.client import FutureCancelledError

    return FutureCancelledError(key, why)


def closed(text: str) -> Exception:
    from distributed.comm.core import CommClosedError

    return CommClosedError(text)


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """No scheduler and no waiting."""
    monkeypatch.setattr("distributed.Client", Client)
    monkeypatch.setattr("distributed.as_completed", Completed)
    monkeypatch.setattr(scheduling.time, "sleep", lambda _: None)
    monkeypatch.setattr(Client, "submitted", [])


@pytest.mark.parametrize(
    "harms",
    [
        lambda: [cancelled("machine=m/day=d1-t", "scheduler-connection-lost")],
        lambda: [closed("in <TCP>: Stream is closed"), cancelled("k", "scheduler-restart"), OSError("gone")],
    ],
)
def test_a_scheduler_that_goes_while_a_result_is_fetched_is_waited_for(
    harms: Callable[[], list[Exception]], at_once: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    happened = harms()
    monkeypatch.setattr(Client, "harms", list(happened))
    taken: list[str] = []
    said: list[str] = []
    run_all(tasks(4 + len(happened)), Cluster("tcp://127.0.0.1:1"), lambda outcome: taken.append(outcome.name), said.append)
    assert taken == [f"machine=m/day=d{n}" for n in range(4 + len(happened))]
    assert Client.submitted.count("machine=m/day=d0") == 1
    assert Client.submitted.count("machine=m/day=d1") == 2
    assert sum("is gone; waiting for it" in line for line in said) == len(happened)


def test_what_the_client_has_no_word_for_is_raised(at_once: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Client, "harms", [InputError("season", "was taken over", "one run at a time")])
    with pytest.raises(InputError, match="taken over"):
        run_all(tasks(3), Cluster("tcp://127.0.0.1:1"), _ignore, _ignore)


class Failed(Future):
    """Of a worker whose storage went, as when another run cleaned it away."""

    def exception(self) -> OSError:  # type: ignore[override]
        """What the task raised."""
        return OSError("no such folder")


def test_a_task_that_fails_once_another_run_has_the_dataset_is_one_line(
    at_once: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(Client, "submit", lambda self, work, task, **how: Failed(task.partition.name, None))
    Dataset(str(tmp_path / "season")).begin()
    task = SimpleNamespace(
        partition=Partition("m", "d", ()), token="of the run before", dataset=str(tmp_path / "season"), software=software(),
        parameters_sha256="",
    )  # fmt: skip
    with pytest.raises(InputError, match="taken over by another"):
        run_all([task], Cluster("tcp://127.0.0.1:1"), _ignore, _ignore)  # type: ignore[list-item]
    assert Dataset(str(tmp_path / "season")).failures() == []


def test_a_day_whose_worker_died_behind_its_commit_is_there(
    at_once: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Dask gives a task up with which three workers died; that they had done their work is seen by its commit."""
    path = logs.write(tmp_path / "a.log")
    dataset, loaded = Dataset(str(tmp_path / "season")), configuration.load(shipped("config/yieldmon.yaml"))
    token, sha256 = dataset.begin(), parameters_sha256(loaded)
    committed, changed = (
        Task(Partition("m", day, (str(path),)), dataset.address, token, loaded, sha256, software()) for day in ("d1", "d2")
    )
    for task in (committed, changed):
        assert work(task).status == DONE
    monkeypatch.setattr(Client, "submit", lambda self, work, task, **how: Failed(task.partition.name, None))
    outcomes: list[Outcome] = []
    other = replace(changed, parameters_sha256="of other parameters")
    run_all([committed, other], Cluster("tcp://127.0.0.1:1"), outcomes.append, _ignore)
    assert [outcome.status for outcome in outcomes] == [SKIPPED, FAILED]
    assert [failure["day"] for failure in dataset.failures()] == ["d2"]


def _ignore(_: Any) -> None:
    """Of no interest."""


def test_workers_are_begun_without_the_terminals_interrupt(monkeypatch: pytest.MonkeyPatch) -> None:
    import dask

    held = []

    def started(**_: object) -> None:
        held.append(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ()))
        assert not dask.config.get("distributed.worker.profile.enabled"), "sampling frames can block a worker for ever"
        raise RuntimeError("no processes")

    monkeypatch.setattr("distributed.LocalCluster", started)
    with pytest.raises(OSError, match="no processes"):
        run_all(tasks(1), Cluster(workers=2), lambda outcome: None, lambda line: None)
    assert held == [True] * 3, "each of three starts"
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_workers_begin_without_what_no_partition_needs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """python-can takes asammdf along, and that pandas and sympy: half of what a worker's start took. What all need is imported
    once, by the process that they are forked from."""
    found: list[Outcome] = []
    monkeypatch.setattr(scheduling, "work", imported)
    task = Task(
        Partition("m", "d", ("a.log",)), str(tmp_path), "", configuration.load(shipped("config/yieldmon.yaml")), "", software()
    )
    run_all([task], Cluster(workers=1), found.append, lambda line: None)
    assert [set(outcome.why_left.split()) for outcome in found] == [{"can", "numba"}]
    assert found[0].seconds != os.getpid()


def imported(task: Task) -> Outcome:
    """In a worker, which has imported what it takes to measure: what of these is among it."""
    asked = {"can", "numba", "asammdf", "pandas", "sympy"}
    return Outcome(task.partition.name, DONE, seconds=os.getppid(), why_left=" ".join(asked & {*sys.modules}))


PREFORK = """
import os, sys
import yieldmon.fleet.prefork
print(len(os.listdir("/proc/self/task")), {"asammdf", "pandas", "sympy"} & {*sys.modules}, "numba" in sys.modules)
"""


def test_what_workers_are_forked_from_has_one_thread() -> None:
    """A fork keeps the thread that forks alone, and the locks of all."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    said = subprocess.run((sys.executable, "-c", PREFORK), env=environment, capture_output=True, text=True, check=True)
    assert said.stdout == "1 set() True\n"
