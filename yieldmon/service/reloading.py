"""Reading the configuration anew while the daemon runs, on a thread of its own: on a disk that hangs nothing else waits."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from time import monotonic

from yieldmon.errors import InputError
from yieldmon.service.answering import on_a_thread
from yieldmon.service.config.configuration import Configuration

_log = logging.getLogger(__name__)

#: Readings that may hang at the same time: each keeps a thread for as long as its disk does.
_HANG_AT_MOST = 3


class Reloading:
    """One reading at a time, what became of the last one, and those that were given up.

    Parameters
    ----------
    read : callable
        Reads the configuration; raises InputError or OSError where it cannot be used. None: there is none to be read.
    limit_s : float
        How long a reading may take.

    Attributes
    ----------
    count : int
        Readings that were taken or refused.
    note : str
        What became of the last one.
    """

    def __init__(self, read: Callable[[], Configuration] | None, limit_s: float) -> None:
        self._read = read
        self._limit_s = limit_s
        self._reading: Future[Configuration] | None = None
        self._begun_s = 0.0
        self._begun: list[Future[Configuration]] = []
        self.count = 0
        self.note = "none since the start"

    @property
    def under_way(self) -> bool:
        """Whether a reading is awaited."""
        return self._reading is not None

    @property
    def due(self) -> bool:
        """Whether a reading has ended, or takes longer than it may."""
        return self._reading is not None and (self._reading.done() or monotonic() - self._begun_s > self._limit_s)

    def begin(self) -> None:
        """Begin a reading; `take` says why where there can be none."""
        self._begun = [reading for reading in self._begun if not reading.done()]
        try:
            if len(self._begun) >= _HANG_AT_MOST:
                raise InputError("reload", f"{len(self._begun)} earlier ones still wait for the disk", "a disk that answers")
            self._reading = on_a_thread(self._configuration, "reload")
            self._begun.append(self._reading)
        except (InputError, RuntimeError) as error:
            self._reading = Future()
            self._reading.set_exception(error if isinstance(error, InputError) else InputError("reload", str(error)))
        self._begun_s = monotonic()

    def take(self, use: Callable[[Configuration], Sequence[str]]) -> None:
        """Take the configuration that was read, or go on with the one before and say so; to be called when it is due.

        use: takes the configuration and returns what is to be said of it; raises InputError or OSError where it cannot be used.
        """
        self.count += 1
        try:
            new = self._result()
            self.note = "; ".join(("taken", *use(new)))
            _log.info("configuration reloaded: %s", self.note)
            for note in new.notes:
                _log.warning("%s", note)
        except (InputError, OSError) as error:
            # A file that could not be read this time is no reason to stop measuring.
            self.note = f"refused: {error}"
            _log.error("reload refused, the old configuration stays in use: %s", error)

    def _configuration(self) -> Configuration:
        """What the reading brings; whatever is in a file, measuring goes on with the configuration before."""
        if self._read is None:
            raise InputError("reload", "this run has no configuration file", "`yieldmon run --config F`")
        try:
            return self._read()
        except (InputError, OSError):
            raise
        except Exception as error:
            _log.exception("reload")
            raise InputError("reload", f"{type(error).__name__}: {error}") from error

    def _result(self) -> Configuration:
        """The configuration that was read. Raises InputError for a reading that takes too long, and as the reading."""
        assert self._reading is not None
        reading, self._reading = self._reading, None
        if not reading.done():
            raise InputError("reload", f"the configuration could not be read within {self._limit_s:g} s", "a disk that answers")
        return reading.result()
