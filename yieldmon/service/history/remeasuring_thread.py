"""Measures loads again on a thread of its own, and takes over the result."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path

from yieldmon.engine.monitor_view import MonitorView
from yieldmon.physics.machine import Machine
from yieldmon.service.answering import on_a_thread
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.remeasuring import MeasuredAgain, at_its_end, of_store
from yieldmon.service.tickets.action_log import ActionLog

_log = logging.getLogger(__name__)

_WRITING_S = 10.0
"""A job waits so long for the store to hold what was handed to it."""


@dataclass(frozen=True)
class RemeasuringJob:
    """Loads that are to be measured again.

    Parameters
    ----------
    tickets : tuple of int
        That ask for it; none after an undo.
    version : int
        Of the parameters to measure with.
    open_load : int or None
        Left out as it is open.
    now_s : float
        Bus time.
    closed_load : int or None
        The only load that this is about; None for all of the last days.
    crop : str
        Of the parameters, where they do not say so.
    """

    tickets: tuple[int, ...]
    version: int
    open_load: int | None
    now_s: float
    closed_load: int | None = None
    crop: str = ""


@dataclass(frozen=True)
class RemeasuringResult:
    """The result of a job. version: of the parameters that its loads were measured with; loads: by number, none where they
    could not be measured again, None where the store did not hold yet what was handed to it."""

    asked: RemeasuringJob
    version: int
    loads: Mapping[int, MeasuredAgain] | None


class RemeasuringThread:
    """Measures loads again on a thread of its own, one job at a time."""

    def __init__(self, path: Path, written: Callable[[float], bool]) -> None:
        """path: of the store. written: waits so many seconds until the store holds all that was handed to it."""
        self._path = path
        self._written = written
        self._job: Future[RemeasuringResult] | None = None

    @property
    def busy(self) -> bool:
        """Whether a job is under way, or its result not taken yet."""
        return self._job is not None

    def start(self, machine: Machine, job: RemeasuringJob) -> None:
        """Begin a job; not while busy. Without room for a thread there is none, which is said."""
        try:
            self._job = on_a_thread(lambda: self._result(machine, job), "remeasuring")
        except RuntimeError as error:
            _log.error("the loads cannot be recomputed: %s", error)

    def start_next(self, journal: Journal, monitor: MonitorView) -> None:
        """Begin what is to be measured again, where there is something and no job is under way.

        Those are the last days' loads, after a ticket updated the parameters or an undo brought others back, and the load that
        was open then, once it is closed.
        """
        if monitor.masses_wait or self.busy:
            return
        actions, in_use = journal.actions, monitor.estimator.parameters
        machine, now_s, totals = monitor.machine, monitor.bus_time_s, monitor.totals
        open_load = totals.load_number if totals.load_open else None
        if actions.remeasuring.restored_waits or actions.measuring_waits:
            # First what an undo brought back: what tickets change after it counts.
            taken = actions.take_restored() if actions.remeasuring.restored_waits else actions.take_to_measure(in_use.version)
            asked = RemeasuringJob(*taken, open_load, now_s)
        elif (closed := actions.closed_load(open_load)) is not None:
            number, by = closed
            asked = RemeasuringJob(by.tickets, by.version, open_load, now_s, number)
        else:
            return
        self.start(machine, replace(asked, crop=journal.parameters.crop_of_version(asked.version, in_use, journal.crop)))

    def take_into(self, actions: ActionLog) -> bool:
        """Enter what came of the job, once; whether it brought factors, which are to be written before another job reads them."""
        result = self.take()
        if result is None:
            return False
        if result.loads is None:
            actions.remeasuring.not_measured()
            return False
        asked, loads = result.asked, result.loads
        actions.remeasured(
            asked.tickets,
            result.version,
            {number: load.factor for number, load in loads.items()},
            {number: load.spread for number, load in loads.items() if load.spread is not None},
            open_load=asked.open_load,
            closed_load=asked.closed_load,
        )
        return bool(loads)

    def take(self) -> RemeasuringResult | None:
        """What came of the job, once."""
        if self._job is None or not self._job.done():
            return None
        done, self._job = self._job, None
        return done.result()

    def _result(self, machine: Machine, job: RemeasuringJob) -> RemeasuringResult:
        found, version = dict[int, MeasuredAgain](), job.version
        try:
            if not self._written(_WRITING_S):
                return RemeasuringResult(job, version, None)
            if job.closed_load is not None:
                version = at_its_end(self._path, job.closed_load, version)
            undone, only = not job.tickets, job.closed_load
            found = of_store(
                self._path,
                machine,
                version,
                job.open_load,
                job.now_s,
                undone_only=undone,
                only=only,
                crop=job.crop,
            )
        except Exception as error:  # noqa: BLE001 - what was measured stays, and measuring goes on
            _log.error("the loads could not be recomputed: %s", error)
        return RemeasuringResult(job, version, found)
