"""A log that a fault which goes on for days does not fill."""

from __future__ import annotations

import logging
from collections.abc import Callable
from time import monotonic

INTERVAL_S = 60.0
_AT_ONCE = 3


class RateLimitedLog(logging.Filter):
    """Lets through a few messages a minute from each line of the program, and the next minute says how many it kept back."""

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._places: dict[tuple[str, int], tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the message is to be written."""
        place = (record.pathname, record.lineno)
        now_s = self._clock()
        since_s, count = self._places.get(place, (now_s, 0))
        if now_s - since_s >= INTERVAL_S:
            if count > _AT_ONCE:
                record.msg = f"{record.getMessage()} ({count - _AT_ONCE} more like this in the last minute)"
                record.args = ()
            since_s, count = now_s, 0
        self._places[place] = (since_s, count + 1)
        return count < _AT_ONCE
