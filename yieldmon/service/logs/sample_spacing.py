"""How far apart an impact sensor's frames are in a record, held against the mapping: times in another unit show by that."""

from __future__ import annotations

import numpy as np

from yieldmon.engine.sources import SampleSource
from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch

_LOOKED_AT, _LEAST = 500, 20
"""Frames of the sensor."""
_FAR_OFF = 3.0
"""Lost frames, and bursts, make less."""
_SAME = 0.1
_UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}


class SampleSpacing:
    """The first frames of the first sensor."""

    def __init__(self, source: SampleSource) -> None:
        """source: the sensor as it is mapped."""
        self._times_s: list[float] = []
        self.mapped_s = source.interval_s * len(source.signals)
        """From frame to frame."""

    def take(self, item: Stretch | EndOfLog) -> None:
        """The next part of the record."""
        if isinstance(item, EndOfLog):
            return
        for run in item.runs:
            if len(self._times_s) < _LOOKED_AT:
                self._times_s += run.times_s[run.samples[0].places].tolist()

    @property
    def far_off_s(self) -> float | None:
        """Median time from frame to frame, s, where it is far from what the mapping says."""
        steps = np.diff(self._times_s[:_LOOKED_AT])
        found = float(np.median(steps)) if steps.size >= _LEAST else self.mapped_s
        return found if found > 0.0 and not 1.0 / _FAR_OFF < found / self.mapped_s < _FAR_OFF else None


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
