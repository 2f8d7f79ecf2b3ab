"""The stored loads that a command needs, read on the thread that asks: the engine's must not wait for a disk."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError
from yieldmon.service.history.reference_loads import StoredLoad, of_new_ticket, of_standing_tickets
from yieldmon.service.operator import commands
from yieldmon.service.operator.control_protocol import ControlError

_log = logging.getLogger(__name__)

_READ_AT_ONCE = 2
"""Commands that may read the store at the same time: those that a hanging disk holds up must not take the place of all others."""


class CommandLoads:
    """Reads loads for commands; called on any thread.

    Parameters
    ----------
    timeout_s : float
        How long a command waits for others that read.
    """

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._reading = threading.BoundedSemaphore(_READ_AT_ONCE)

    def of(self, request: Mapping[str, Any], path: Path) -> Sequence[StoredLoad]:
        """Loads of a store that a request names or updates again; none where they cannot be read.

        Raises ControlError while the disk holds others up.
        """
        numbers, updates_again = commands.ticketed_loads(request), request["command"] in commands.UPDATE_AGAIN
        if not numbers and not updates_again:
            return ()
        if not self._reading.acquire(timeout=self._timeout_s):
            raise ControlError("the disk does not answer; nothing was done")
        try:
            return of_standing_tickets(path, numbers) if updates_again else of_new_ticket(path, numbers)
        except InputError as error:
            _log.warning("loads of an earlier run cannot be read: %s", error)
            return ()
        finally:
            self._reading.release()
