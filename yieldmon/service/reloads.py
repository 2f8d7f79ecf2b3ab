"""Readings of the configuration while the daemon runs, and what came of the last one."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from yieldmon.errors import InputError
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.reloading import Reloading

_log = logging.getLogger(__name__)


class Reloads:
    """One reading at a time, and what became of it.

    Attributes
    ----------
    count : int
        Readings that were taken or refused.
    note : str
        What came of the last one.
    """

    def __init__(self, reading: Reloading) -> None:
        self._reading = reading
        self.count = 0
        self.note = "none since the start"

    @property
    def under_way(self) -> bool:
        """Whether a reading is awaited."""
        return self._reading.under_way

    @property
    def due(self) -> bool:
        """Whether a reading has ended, or takes longer than it may."""
        return self._reading.due()

    def begin(self) -> None:
        """Begin a reading."""
        self._reading.begin()

    def take(self, use: Callable[[Configuration], Sequence[str]]) -> None:
        """Take the configuration that was read, or go on with the one before and say so; to be called when it is due.

        use: takes the configuration and returns what is to be said of it; raises InputError or OSError where it cannot be used.
        """
        self.count += 1
        try:
            new = self._reading.result()
            self.note = "; ".join(("taken", *use(new)))
            _log.info("configuration reloaded: %s", self.note)
            for note in new.notes:
                _log.warning("%s", note)
        except (InputError, OSError) as error:
            # A file that could not be read this time is no reason to stop measuring.
            self.note = f"refused: {error}"
            _log.error("reload refused, the old configuration stays in use: %s", error)
