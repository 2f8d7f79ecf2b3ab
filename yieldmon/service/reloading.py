"""Reading the configuration anew on a thread of its own: on a disk that hangs nothing else waits."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future
from time import monotonic

from yieldmon.errors import InputError
from yieldmon.service.config.configuration import Configuration

_log = logging.getLogger(__name__)

#: Readings that may hang at the same time: each keeps a thread for as long as its disk does.
_HANG_AT_MOST = 3


class Reloading:
    """At most one reading that is awaited, and those that were given up.

    Parameters
    ----------
    read : callable
        Reads the configuration; raises InputError or OSError where it cannot be used. None: there is none to be read.
    limit_s : float
        How long a reading may take.
    """

    def __init__(self, read: Callable[[], Configuration] | None, limit_s: float) -> None:
        self._read = read
        self._limit_s = limit_s
        self._reading: Future[Configuration] | None = None
        self._begun_s = 0.0
        self._threads: list[threading.Thread] = []

    @property
    def under_way(self) -> bool:
        """Whether a reading is awaited."""
        return self._reading is not None

    def begin(self) -> None:
        """Begin a reading; its end, or why there is none, is `result`'s to say."""
        read, reading = self._read, Future[Configuration]()

        def body() -> None:
            try:
                if read is None:
                    raise InputError("reload", "this run has no configuration file", "`yieldmon run --config F`")
                reading.set_result(read())
            except (InputError, OSError) as error:
                reading.set_exception(error)
            except Exception as error:  # noqa: BLE001 - whatever is in a file, measuring goes on with the one before
                _log.exception("reload")
                reading.set_exception(InputError("reload", f"{type(error).__name__}: {error}"))

        self._threads = [thread for thread in self._threads if thread.is_alive()]
        if len(self._threads) >= _HANG_AT_MOST:
            problem = f"{len(self._threads)} earlier ones still wait for the disk"
            reading.set_exception(InputError("reload", problem, "a disk that answers"))
        else:
            thread = threading.Thread(target=body, name="reload", daemon=True)
            try:
                thread.start()
                self._threads.append(thread)
            except RuntimeError as error:
                reading.set_exception(InputError("reload", str(error)))
        self._reading, self._begun_s = reading, monotonic()

    def due(self) -> bool:
        """Whether a reading has ended, or takes longer than it may."""
        return self._reading is not None and (self._reading.done() or monotonic() - self._begun_s > self._limit_s)

    def result(self) -> Configuration:
        """What the reading brought, to be asked when it is due. Raises InputError for one that takes too long, and as the
        reading."""
        assert self._reading is not None
        reading, self._reading = self._reading, None
        if not reading.done():
            raise InputError("reload", f"the configuration could not be read within {self._limit_s:g} s", "a disk that answers")
        return reading.result()
