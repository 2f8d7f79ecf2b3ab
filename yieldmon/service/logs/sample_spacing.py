"""How far apart an impact sensor's frames are in a record, held against the mapping: times in another unit show by that."""

from __future__ import annotations

import numpy as np

from yieldmon.engine.sources import SampleSource
from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch

_LOOKED_AT, _LEAST = 500, 20
"""Frames of the sensor."""
_FAR_OFF = 3.0
"""Lost frames, and bursts, make less."""


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
        times_s = np.array(self._times_s[:_LOOKED_AT])
        if times_s.size <= _LEAST:
            return None
        # Of frames that two loggers recorded, each comes twice: every other step is none of the sensor's.
        found = max(float(np.median(np.diff(times_s))), float(np.median(times_s[2:] - times_s[:-2])) / 2.0)
        return found if found > 0.0 and not 1.0 / _FAR_OFF < found / self.mapped_s < _FAR_OFF else None
