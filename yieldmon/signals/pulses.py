"""Speed of a shaft from a counter of its pulses."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

_SPAN_S = 0.5
"""Time over which pulses are counted for one speed: long enough that one pulse more or less is a small share."""
_LONGEST_S = 2.0


class PulseSpeed:
    """Counts in, turns per minute out. modulus: the counter wraps there."""

    def __init__(self, pulses_per_turn: float, modulus: int) -> None:
        self._pulses_per_turn = pulses_per_turn
        self._modulus = modulus
        self._seen: deque[tuple[float, int]] = deque()

    def speed_rpm(self, time_s: float, count: int) -> float:
        """Speed after a frame; nan for the first one, after a pause, and where time does not advance."""
        seen = self._seen
        if seen and not 0.0 <= time_s - seen[-1][0] <= _LONGEST_S:
            seen.clear()
        if seen and time_s == seen[-1][0]:
            return float("nan")
        seen.append((time_s, count))
        while len(seen) > 2 and time_s - seen[1][0] >= _SPAN_S:
            seen.popleft()
        if len(seen) < 2:
            return float("nan")
        pulses = sum((after - before) % self._modulus for (_, before), (_, after) in pairwise(seen))
        return 60.0 * pulses / self._pulses_per_turn / (time_s - seen[0][0])
