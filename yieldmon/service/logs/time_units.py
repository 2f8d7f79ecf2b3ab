"""Times of logs in another unit than seconds, by the time from one frame of an impact sensor to the next."""

from __future__ import annotations

from itertools import pairwise
from statistics import median

from yieldmon.engine.sources import Sources
from yieldmon.errors import InputError

_SAME = 0.1
_UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
_LOOKED_AT = 100
"""Frames of the sensor."""


class TimeUnitCheck:
    """Refuses a record whose times are in milliseconds or less: nothing can be measured in it, and each second, a thousand
    times as many, would be."""

    def __init__(self, sources: Sources) -> None:
        source = sources.impact[0]
        self._mapped_s = source.interval_s * len(source.signals)
        self._times_s: list[float] = []

    @property
    def wants(self) -> bool:
        """Whether it has not seen enough frames yet."""
        return len(self._times_s) < _LOOKED_AT

    def take(self, where: str, times_s: list[float]) -> None:
        """The next frames of the first impact sensor. Raises InputError."""
        if not self.wants:
            return
        self._times_s += times_s
        if self.wants:
            return
        found_s = median(abs(later - earlier) for earlier, later in pairwise(self._times_s[:_LOOKED_AT]))
        if found_s > self._mapped_s and unit_slip(found_s, self._mapped_s):
            raise InputError(where, spacing_line(found_s, self._mapped_s), "times in seconds, or the sensor's rate in `signals`")


def spacing_line(found_s: float, mapped_s: float) -> str:
    """What is to be said of it.

    Parameters
    ----------
    found_s, mapped_s : float
        Time from frame to frame, s.

    Returns
    -------
    str

    Examples
    --------
    >>> spacing_line(4.0, 0.004)
    "the log's times are 1000 times too far apart, as of milliseconds that stand for seconds: a sensor frame every 4 s, by the \
mapping every 0.004 s"
    """
    every = f"a sensor frame every {found_s:.4g} s, by the mapping every {mapped_s:.4g} s"
    slip = unit_slip(found_s, mapped_s)
    return f"{slip}: {every}" if slip else f"{every}: rate_hz of the mapping, or the log's times, are not right"


def unit_slip(found_s: float, mapped_s: float) -> str:
    """What times in another unit look like; "" where it is none of these. found_s, mapped_s: as of `spacing_line`."""
    for factor, unit in _UNITS.items():
        if abs(found_s / mapped_s / factor - 1.0) < _SAME:
            return f"the log's times are {factor:.0f} times too far apart, as of {unit} that stand for seconds"
        if abs(found_s / mapped_s * factor - 1.0) < _SAME:
            return f"the log's times are {factor:.0f} times too near each other"
    return ""
