"""Threads of the daemon: helpers, restarted when they die or hang while measuring goes on, and the end of all of them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Protocol

_log = logging.getLogger(__name__)

#: A thread hangs when it has been in one round for so long and for so many looks; after a SIGSTOP the time alone would say so.
HANGS_S, HANGS_LOOKS = 20.0, 20
#: Restarts of a thread in one run; where a disk hangs, each thread that is given up stays.
MOST = 5


class Helper(Protocol):
    """A part of the daemon with a thread of its own."""

    @property
    def alive(self) -> bool:
        """Whether the thread runs, where it is to."""

    @property
    def busy_since_s(self) -> float | None:
        """Monotonic time at which the thread began what it is at; None while it waits for its time."""

    def restart(self) -> None:
        """Leave the thread to itself and begin another one. Raises RuntimeError where the system has no room for it."""


class Supervisor:
    """Looks after one helper.

    Parameters
    ----------
    name : str
        For the journal.
    helper : Helper
    """

    def __init__(self, name: str, helper: Helper) -> None:
        self._name = name
        self._helper = helper
        self._busy_since_s: float | None = None
        self._looks = 0
        self._left = MOST

    def look(self, now_s: float) -> None:
        """To be called about once a second; now_s: monotonic time."""
        trouble = self._trouble(now_s)
        if not trouble or not self._left:
            return
        self._left -= 1
        self._looks = 0
        more = "" if self._left else ", for the last time in this run"
        _log.error("the %s thread %s; restarted%s", self._name, trouble, more)
        try:
            self._helper.restart()
        except RuntimeError as error:
            _log.error("the %s thread: %s", self._name, error)

    def _trouble(self, now_s: float) -> str:
        if not self._helper.alive:
            return "has died"
        since_s = self._helper.busy_since_s
        if since_s is None or since_s != self._busy_since_s:
            self._busy_since_s, self._looks = since_s, 0
            return ""
        self._looks += 1
        return "hangs" if self._looks >= HANGS_LOOKS and now_s - since_s >= HANGS_S else ""


def require_alive(threads: Mapping[str, bool]) -> None:
    """Raises RuntimeError where a thread, by its name, is not alive."""
    for name, alive in threads.items():
        if not alive:
            raise RuntimeError(f"the {name} thread has died")


def ended(*steps: Callable[[], object]) -> bool:
    """Takes each step, whatever became of the one before; False where one failed."""
    whole = True
    for step in steps:
        try:
            step()
        except Exception:  # noqa: BLE001 - the disk is still to be written to when anything else fails
            _log.exception("stopping")
            whole = False
    return whole
