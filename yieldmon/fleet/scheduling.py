"""Tasks on Dask distributed: a cluster of this machine's processes, or one that runs elsewhere.

Dask does the work of distribution: queues, workers that die, load. What is added is the way back after the scheduler itself was
lost: partitions are independent and committed by the workers, so what is not answered for is submitted again.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing import resource_tracker
from typing import Any

from yieldmon.errors import InputError
from yieldmon.fleet import preloading
from yieldmon.fleet.dataset import Dataset, Superseded
from yieldmon.fleet.worker import Outcome, Task, failed, found_in_dataset, left_to_next_run, work

_RETRIES = 2
"""Of a task that failed for other reasons than its inputs, a storage that did not answer for instance."""
_DEATHS = 3
"""Workers that may die with a task before it is given up, and while they start before the run is; and how often all of them may
end without an answer."""
_IN_FLIGHT = 256
_INSTEAD = "--workers 0 measures in this process alone"
_FORKSERVER, _PREFORK = "forkserver", "yieldmon.fleet.prefork"
_QUIET = logging.CRITICAL
"""Of Dask's own lines, here and in the workers: what goes wrong is said by what comes back."""
_LOOKED_AFTER_S = 0.1
"""Between two looks at whether workers are left."""
_TIMEOUT_S = 60.0
"""How long a scheduler that is gone is waited for."""


@dataclass(frozen=True)
class Cluster:
    """Where tasks run.

    scheduler: address of a running one, "" for workers of this machine. workers: processes here, 0 for this process itself.
    adaptive: as many of them as there is work for.
    """

    scheduler: str = ""
    workers: int = 1
    adaptive: bool = False


def run_all(tasks: Sequence[Task], cluster: Cluster, take: Callable[[Outcome], None], say: Callable[[str], None]) -> None:
    """Work off the tasks in any order.

    Parameters
    ----------
    tasks : sequence of Task
    cluster : Cluster
    take : callable
        Called once with each task's outcome.
    say : callable
        Called with the dashboard's address, and with lines about a scheduler that is gone.

    Raises
    ------
    InputError
        Another run took the dataset over; no scheduler at the address.
    OSError
        The scheduler stayed away, or the workers of this machine did not stay.
    """
    left = {task.partition.name: task for task in tasks}
    lost = _lost()
    met = False
    deserted = 0
    deadline = time.monotonic() + (_TIMEOUT_S if cluster.scheduler else 0.0)
    while left:
        answered = len(left)
        try:
            with _client(cluster) as client:
                say(f"dashboard: {client.dashboard_link}")
                met = True
                for outcome in _answers(client, list(left.values())):
                    del left[outcome.name]
                    take(outcome)
        except _Deserted as error:
            deserted = 1 if len(left) < answered else deserted + 1
            if deserted == _DEATHS:
                raise OSError(f"the workers end before they answer; {_INSTEAD}") from error
            say("the workers have ended; starting others")
        except lost as error:
            if not cluster.scheduler:
                raise
            if len(left) < answered:
                deadline = time.monotonic() + _TIMEOUT_S
            if time.monotonic() > deadline:
                if met:
                    raise OSError(f"the scheduler {cluster.scheduler} is gone; run again, what is finished stays") from error
                where = f"--scheduler {cluster.scheduler}"
                raise InputError(where, "nothing answers there", "the address of a Dask scheduler") from None
            if len(left) < answered or met:
                say(f"the scheduler {cluster.scheduler} is gone; waiting for it")
            time.sleep(1.0)


class _SchedulerLost(Exception):
    """Futures were cancelled, which this process did not ask for."""


class _Deserted(Exception):
    """All workers of this machine have ended, and Dask starts no others."""


def _lost() -> tuple[type[BaseException], ...]:
    from distributed.comm.core import CommClosedError

    # RuntimeError is what a client says whose connections were closed under it, CancelledError what it says when that happens
    # while it fetches a result.
    return (_SchedulerLost, CommClosedError, CancelledError, TimeoutError, OSError, RuntimeError)


@contextmanager
def _client(cluster: Cluster) -> Iterator[Any]:
    import dask
    import distributed

    # Dask's own interface has no types.
    untyped: Any = distributed

    logging.getLogger("distributed").setLevel(_QUIET)
    settings: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": _DEATHS,
        "distributed.comm.timeouts.connect": "10s",
        "distributed.comm.retry.count": 2,
        # Its sampling of all threads' frames can block for ever in CPython 3.11 before 3.11.9 (gh-106883).
        "distributed.worker.profile.enabled": False,
        "distributed.worker.preload": [preloading.__name__],
        # Each is a wake-up of every process, for partitions that take seconds.
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "5s",
        "distributed.worker.memory.monitor-interval": "500ms",
        "distributed.scheduler.active-memory-manager.start": False,
    }
    forked = not cluster.scheduler and cluster.workers > 0 and _FORKSERVER in multiprocessing.get_all_start_methods()
    if not cluster.scheduler:
        settings["distributed.dashboard.link"] = "http://127.0.0.1:{port}/status"
    if forked:
        settings["distributed.worker.multiprocessing-method"] = _FORKSERVER
    with dask.config.set(settings):
        if cluster.scheduler:
            try:
                client = untyped.Client(cluster.scheduler, timeout=5)
            except ValueError as error:
                raise InputError("--scheduler", f"is {cluster.scheduler!r}", "an address such as tcp://host:8786") from error
            try:
                yield client
            finally:
                with suppress(*_lost()):
                    client.close(timeout=2)
            return
        with _started(cluster.workers, forked=forked) as local:
            if cluster.adaptive:
                local.adapt(minimum=1, maximum=max(1, cluster.workers))
            with untyped.Client(local) as client:
                yield client


def _started(workers: int, *, forked: bool) -> Any:
    """Workers of this machine, begun anew where one of them dies while they start. Raises OSError."""
    import distributed

    untyped: Any = distributed
    here = {"processes": False, "n_workers": 1} if workers == 0 else {"n_workers": workers}
    failed: BaseException | None = None
    for _ in range(_DEATHS):
        try:
            with _interrupts_are_ours():
                if forked:
                    _begin_forking()
                return untyped.LocalCluster(threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=_QUIET, **here)
        except (RuntimeError, OSError) as error:
            failed = error
    cause = failed
    while cause is not None and (before := cause.__cause__ or cause.__context__):
        cause = before
    instead = f"; {_INSTEAD}" if workers else ""
    raise OSError(f"the workers do not start: {cause}{instead}") from failed


@contextmanager
def _interrupts_are_ours() -> Iterator[None]:
    """Processes and threads begun meanwhile take no Ctrl-C, which a terminal sends to all: this one stops them in order."""
    # Begun later, it would let the signal through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_forking() -> None:
    """Begin the process that workers are forked from, with what they need imported once."""
    from multiprocessing import forkserver

    import dask
    import distributed

    untyped: Any = distributed
    # Else Dask imports here and there what it might need itself, pandas for one.
    untyped.utils._forkserver_preload_set = True
    for name, value in dask.config.get("distributed.nanny.pre-spawn-environ", {}).items():
        # Threads of numerical libraries, as each worker would have them.
        os.environ.setdefault(name, str(value))
    multiprocessing.set_forkserver_preload([_PREFORK])
    forkserver.ensure_running()


def _answers(client: Any, tasks: Sequence[Task]) -> Iterator[Outcome]:
    import distributed

    waiting = iter(tasks)
    submitted = {_submit(client, task): task for task in islice(waiting, _IN_FLIGHT)}
    untyped: Any = distributed
    completed = untyped.as_completed(list(submitted))
    for future in _in_turn(client, completed):
        task = submitted.pop(future)
        outcome = _answer(future, task)
        for following in islice(waiting, 1):
            another = _submit(client, following)
            submitted[another] = following
            completed.add(another)
        future.release()
        yield outcome


def _in_turn(client: Any, completed: Any) -> Iterator[Any]:
    """The futures as they are done. Raises _Deserted where no worker is left to do the others."""
    if client.cluster is None:
        # One that runs elsewhere, which other workers may join.
        yield from completed
        return
    while completed.count():
        while not completed.has_ready():
            if not _has_workers(client.cluster):
                raise _Deserted
            with completed.thread_condition:
                completed.thread_condition.wait(_LOOKED_AFTER_S)
        yield next(completed)


def _has_workers(local: Any) -> bool:
    """Whether a worker of this machine is there or being started."""
    from distributed.core import Status

    return any(worker.status not in (Status.closed, Status.failed) for worker in local.workers.values())


def _submit(client: Any, task: Task) -> Any:
    # With the token in its name a task of an earlier run is not taken for one of this run.
    return client.submit(work, task, key=f"{task.partition.name}-{task.token}", retries=_RETRIES, pure=False)


def _answer(future: Any, task: Task) -> Outcome:
    if future.status in ("cancelled", "lost"):
        raise _SchedulerLost
    problem = future.exception()
    if problem is None:
        outcome: Outcome = future.result()
        return outcome
    try:
        if isinstance(problem, Superseded):
            raise problem
        known = found_in_dataset(task)
        if known is not None:
            return known
        if isinstance(problem, MemoryError) or (isinstance(problem, OSError) and problem.errno is not None):
            return left_to_next_run(task, problem)
        return failed(task, f"{type(problem).__name__}: {' '.join(str(problem).split())[:300]}")
    except OSError as error:
        return left_to_next_run(task, error)
    except Superseded:
        raise Dataset(task.dataset).taken_over() from None
