"""Speed of a shaft from a counter of its pulses."""

from __future__ import annotations

from collections import deque

_SPAN_S = 0.5
"""Time over which pulses are counted for one speed: long enough that one pulse more or less is a small share."""
_LONGEST_S = 2.0


class PulseSpeed:
    """Counts in, turns per minute out.

    modulus: the counter turns there, or at `values` where a count beyond shows that it does not. Until one has come, whichever
    goes on as fast as the pulses before.
    """

    def __init__(self, pulses_per_turn: float, modulus: int, values: int | None = None) -> None:
        self._pulses_per_turn = pulses_per_turn
        self._modulus = modulus
        self._values = values or modulus
        self._seen: deque[tuple[float, int, int]] = deque()
        """Time, count, and pulses since the first."""
        self._pulses_per_s = 0.0

    def speed_rpm(self, time_s: float, count: int) -> float:
        """Speed after a frame; nan for the first one, after a pause, and where time does not advance."""
        seen = self._seen
        if count >= self._modulus:
            self._modulus = self._values
        if seen and not 0.0 <= time_s - seen[-1][0] <= _LONGEST_S:
            seen.clear()
        if not seen:
            seen.append((time_s, count, 0))
            self._pulses_per_s = 0.0
            return float("nan")
        last_s, before, pulses = seen[-1]
        if time_s == last_s:
            return float("nan")
        more = self._between(before, count, self._pulses_per_s * (time_s - last_s))
        self._pulses_per_s = more / (time_s - last_s)
        seen.append((time_s, count, pulses + more))
        while len(seen) > 2 and time_s - seen[1][0] >= _SPAN_S:
            seen.popleft()
        return 60.0 * (pulses + more - seen[0][2]) / self._pulses_per_turn / (time_s - seen[0][0])

    def _between(self, before: int, count: int, expected: float) -> int:
        pulses = (count - before) % self._modulus
        if count >= before or self._modulus == self._values or not expected:
            return pulses
        others = (count - before) % self._values
        return others if abs(others - expected) < abs(pulses - expected) else pulses
