"""Bus time to engine time: the same while the bus's clock runs, and continuous when it is set.

Engine time never runs back and never jumps. A step of the bus's clock changes only the offset between the two, so windows,
time-outs and totals continue as if the clock had not been set. Shortly after a step a pause counts as another step: time stamps
that alternate between two clocks (a log of two recorders, line by line) would otherwise give a minute of silence each time. A
long step forward from one log to the next is a pause of the recorder, not a jump of the clock; engine time is continuous there
too.
"""

from __future__ import annotations

from math import isfinite

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.settings import ClockSettings

_LARGEST_TIME_S = 1e11
"""Largest time stamp that a double resolves well below a sample interval."""
_FRAMES_TO_SETTLE, _LONGEST_PAUSE_S = 32, 1.0
"""Within this many frames after a step of the clock, a pause longer than this is another step."""


class BusClock:
    """Maps bus time stamps (s, any epoch) to engine time (s)."""

    def __init__(self, settings: ClockSettings) -> None:
        self._settings = settings
        self.offset_s = 0.0
        self.now_s: float | None = None
        """Latest engine time; None before the first frame."""
        self.jumps = 0
        self.unusable = 0
        self._to_settle = 0
        self._between_logs = False
        self.paused_s = 0.0
        """Length of the recorder's pause before the last frame, s; the reader sets it back to 0."""

    def begin_log(self) -> None:
        """The next frame is the first of another log."""
        self._between_logs = self.now_s is not None

    def engine_time(self, bus_time_s: float) -> float | None:
        """Engine time of a frame and advance to it; None when the time stamp is not a usable number.

        A frame out of order by less than the tolerance gets its own, earlier time and does not move `now_s`.
        """
        if not isfinite(bus_time_s) or abs(bus_time_s) > _LARGEST_TIME_S:
            self.unusable += 1
            return None
        now = self.now_s
        time_s = bus_time_s + self.offset_s
        if now is None:
            self.now_s = time_s
            return time_s
        step = time_s - now
        between_logs, self._between_logs = self._between_logs, False
        settling = self._to_settle > 0
        if settling:
            self._to_settle -= 1
        if step >= 0.0:
            if step > (_LONGEST_PAUSE_S if settling else self._settings.max_gap_s):
                self._absorb(bus_time_s, now)
                if between_logs:
                    self.jumps -= 1
                    self.paused_s = step
                return now
            self.now_s = time_s
            return time_s
        if step < -self._settings.backstep_tolerance_s:
            self._absorb(bus_time_s, now)
            return now
        return time_s

    def regular(self, bus_times_s: NDArray[np.float64]) -> bool:
        """Whether the times (n,) continue from now without a backward step or a jump, so that they can be taken as a block."""
        if self.now_s is None or self._to_settle or bus_times_s.size == 0:
            return False
        steps = np.diff(bus_times_s + self.offset_s, prepend=self.now_s)
        return bool(np.all((steps >= 0.0) & (steps <= self._settings.max_gap_s)))

    def passed(self, now_s: float) -> None:
        """Advance over a block of times that `regular` accepts; now_s: engine time of the last one."""
        self.now_s = now_s
        self._between_logs = False

    def bus_time(self, engine_time_s: float) -> float:
        """Bus time stamp for something that happens at an engine time."""
        return engine_time_s - self.offset_s

    def _absorb(self, bus_time_s: float, now_s: float) -> None:
        self.offset_s = now_s - bus_time_s
        self.jumps += 1
        self._to_settle = _FRAMES_TO_SETTLE
