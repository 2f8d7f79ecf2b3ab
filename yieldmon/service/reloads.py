"""Requests to read the configuration anew, and what came of the last one."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from yieldmon.errors import InputError
from yieldmon.service.configuration import Configuration
from yieldmon.service.notify import ServiceManager
from yieldmon.service.reloading import Reloading

_log = logging.getLogger(__name__)


class Reloads:
    """One reading at a time; a request during one is met by another after it.

    Attributes
    ----------
    count : int
        Readings that were taken or refused.
    note : str
        What came of the last one.
    """

    def __init__(self, reading: Reloading, manager: ServiceManager) -> None:
        self._reading = reading
        self._manager = manager
        # A plain flag: a signal handler runs between any two instructions of the engine's thread, where it may hold any lock.
        self._wanted = False
        self.count = 0
        self.note = "none since the start"

    def request(self) -> None:
        """Read the configuration anew soon; may be called from a signal handler."""
        self._wanted = True

    def look(self, use: Callable[[Configuration], Sequence[str]], *, between_windows: bool) -> bool:
        """Begin a reading where one is wanted, and take one that has ended; whether one was taken or refused.

        use: takes the configuration and returns the sections that will be taken at the next start only; raises InputError or
        OSError where it cannot be used. between_windows: a new monitor has least to miss there.
        """
        if self._wanted and not self._reading.under_way:
            # Before the reading: what is written from now on may need another one.
            self._wanted = False
            self._manager.reloading()
            self._reading.begin()
        if not (between_windows and self._reading.due()):
            return False
        self.count += 1
        try:
            new = self._reading.result()
            later = use(new)
            self.note = "taken" + (f"; {', '.join(later)} will be at the next start" if later else "")
            _log.info("configuration reloaded: %s", self.note)
            for note in new.notes:
                _log.warning("%s", note)
        except (InputError, OSError) as error:
            # A file that could not be read this time is no reason to stop measuring.
            self.note = f"refused: {error}"
            _log.error("reload refused, the old configuration stays in use: %s", error)
        return True
