"""Commands on their way from the control socket's threads to the engine's."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from math import inf
from typing import Any

from yieldmon.errors import InputError
from yieldmon.service.history.reference_loads import StoredLoad
from yieldmon.service.operator.control_protocol import Answer, ControlError


@dataclass(frozen=True)
class Job:
    """A command that waits for its answer. stored: loads that it names, as the store has them."""

    request: Mapping[str, Any]
    stored: Sequence[StoredLoad] = ()
    answer: Future[Answer] = field(default_factory=Future)


class CommandQueue:
    """`ask` is called on any thread, `carry_out` on the engine's."""

    def __init__(self, timeout_s: float, wake: Callable[[], None] = lambda: None) -> None:
        """timeout_s: how long a command waits for the engine. wake: ends what the engine's thread waits for."""
        self._wake = wake
        self._jobs: queue.SimpleQueue[Job] = queue.SimpleQueue()
        self._timeout_s = timeout_s

    def ask(self, request: Mapping[str, Any], stored: Sequence[StoredLoad] = (), left_s: float = inf) -> Answer:
        """Waits for the answer, no longer than left_s; of one that the engine has begun, twice as long as for it to begin. Raises
        InputError for a request that is refused, ControlError where the engine does not answer in time."""
        if left_s <= 0.0:
            raise ControlError("reading the store took too long; nothing was done; ask again")
        job, wait_s = Job(request, stored), min(self._timeout_s, left_s)
        self._jobs.put(job)
        self._wake()
        try:
            return job.answer.result(wait_s)
        except TimeoutError:
            # What was said to have failed must not be done later.
            if job.answer.cancel():
                raise ControlError("the engine did not answer in time; nothing was done") from None
        try:
            return job.answer.result(min(self._timeout_s, left_s - wait_s))
        except TimeoutError:
            raise ControlError(
                "the engine began it and did not finish in time; it may still be done: check `yieldmon status` and the lists "
                "of loads, tickets and calibrations before asking again"
            ) from None

    @property
    def waiting(self) -> bool:
        """Whether there is one to take."""
        return not self._jobs.empty()

    def take(self) -> Iterator[Job]:
        """Those that wait, without what was given up; the caller sets the answer of each."""
        while not self._jobs.empty():
            job = self._jobs.get()
            if job.answer.set_running_or_notify_cancel():
                yield job

    def carry_out(self, execute: Callable[[Job], Answer]) -> list[tuple[Job, Answer]]:
        """Takes and executes those that wait; returns those done, whose answers the caller sets.

        execute: raises InputError for one that is refused, which answers it.
        """
        done = []
        for job in self.take():
            try:
                done.append((job, execute(job)))
            except InputError as error:
                job.answer.set_exception(error)
        return done
