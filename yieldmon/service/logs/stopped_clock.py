"""Samples of a log that all have one time, as of a recorder whose clock stands still: nothing is measured of them."""

from __future__ import annotations

import numpy as np

from yieldmon.engine.sources import Sources
from yieldmon.physics.numerics import Array

_LEAST_S = 3.0
"""Samples of so many seconds at one time: a recorder may write whole seconds, or hold frames back for a moment."""


class StoppedClock:
    """The times of the impact sensors' frames in one log."""

    def __init__(self, sources: Sources) -> None:
        self._frame_s = {source.message: source.interval_s * len(source.signals) for source in sources.impact}
        self._under_way: dict[str, tuple[float, int]] = {}
        """By message, the last frame's time, s, and how many in a row have it."""
        self._stood: dict[str, list[tuple[float, int]]] = {}
        """Times of at least `_LEAST_S` of samples, and the number of frames."""

    def take(self, message: str, times_s: Array) -> None:
        """The next frames (n,) of a message."""
        if message not in self._frame_s or not times_s.size:
            return
        begins = np.flatnonzero(np.append(True, times_s[1:] != times_s[:-1]))
        counts = np.diff(np.append(begins, times_s.size))
        self._add(message, float(times_s[0]), int(counts[0]))
        looked_at = counts >= _LEAST_S / self._frame_s[message]
        # The last may go on with the next frames, as the first went on.
        looked_at[-1] = True
        for place in (np.flatnonzero(looked_at[1:]) + 1).tolist():
            self._close(message)
            self._add(message, float(times_s[begins[place]]), int(counts[place]))

    def take_frame(self, message: str, time_s: float) -> None:
        """One frame, as `take`."""
        if message in self._frame_s:
            self._add(message, time_s, 1)

    def _add(self, message: str, time_s: float, frames: int) -> None:
        last_s, before = self._under_way.get(message, (float("nan"), 0))
        if time_s != last_s:
            self._close(message)
            before = 0
        self._under_way[message] = time_s, before + frames

    def _close(self, message: str) -> None:
        time_s, frames = self._under_way.pop(message, (float("nan"), 0))
        if frames * self._frame_s[message] >= _LEAST_S:
            self._stood.setdefault(message, []).append((time_s, frames))

    def end_of_log(self, path: str) -> list[str]:
        """What is to be said of the log, a line for each sensor whose samples it concerns."""
        for message in list(self._under_way):
            self._close(message)
        lines = []
        for message, stood in self._stood.items():
            frames = sum(count for _, count in stood)
            at_s = max(stood, key=lambda each: each[1])[0]
            lines.append(
                f"{path}: {frames} frames of {message}, {frames * self._frame_s[message]:.0f} s of samples, have one time, "
                f"{at_s:.3f} s{' among others' if len(stood) > 1 else ''}: the recorder's clock stood, and they are not measured"
            )
        return lines
