"""Speed of a shaft from a counter of its pulses."""

from __future__ import annotations

from collections import deque

_SPAN_S = 0.5
_LEAST_PULSES = 12
"""Time over which pulses are counted for one speed, and how many: one pulse more or less is a small share."""
_LONGEST_S = 2.0
"""Time over which they are counted where they are fewer."""
_SOON = 0.25
"""Share of the time after which a counter may have turned; within it no shaft makes more pulses than half of its values."""


class _Span:
    """Pulses per second over the last while."""

    def __init__(self, span_s: float) -> None:
        self._span_s = span_s
        self._seen: deque[tuple[float, int]] = deque()
        """Time, and pulses since the first."""

    def begin(self, time_s: float) -> None:
        self._seen.clear()
        self._seen.append((time_s, 0))

    def rate(self, time_s: float, pulses: int) -> float:
        seen = self._seen
        seen.append((time_s, pulses))
        while len(seen) > 2 and time_s - seen[1][0] >= self._span_s:
            seen.popleft()
        return (pulses - seen[0][1]) / (time_s - seen[0][0])


class PulseSpeed:
    """Counts in, turns per minute out.

    modulus: the counter turns there, or at `values` where a count beyond shows that it does not. Until one has come, whichever
    goes on as fast as the pulses before. longest_s: between counts that do not leave open how often the counter turned.
    """

    def __init__(self, pulses_per_turn: float, modulus: int, values: int | None = None, longest_s: float = _LONGEST_S) -> None:
        self._pulses_per_turn = pulses_per_turn
        self._longest_s, self._soon_s = min(_LONGEST_S, longest_s), _SOON * longest_s
        self._modulus = modulus
        self._values = values or modulus
        self._last: tuple[float, int] | None = None
        """Time and count."""
        self._pulses = 0
        self._short, self._long = _Span(_SPAN_S), _Span(_LONGEST_S)
        self._pulses_per_s = 0.0

    def speed_rpm(self, time_s: float, count: int) -> float:
        """Speed after a frame; nan for the first one, after a pause, and where time does not advance."""
        if count >= self._modulus:
            self._modulus = self._values
        last, self._last = self._last, (time_s, count)
        if last is None or not 0.0 <= time_s - last[0] <= self._longest_s:
            self._pulses, self._pulses_per_s = 0, 0.0
            self._short.begin(time_s)
            self._long.begin(time_s)
            return float("nan")
        last_s, before = last
        if time_s == last_s:
            self._last = last
            return float("nan")
        more = self._between(before, count, self._pulses_per_s * (time_s - last_s))
        if 2 * more > self._modulus and time_s - last_s < self._soon_s:
            # Of an encoder that counts down, or to and fro on a shaft that stands.
            more = self._modulus - more
        self._pulses_per_s = more / (time_s - last_s)
        self._pulses += more
        short, long = self._short.rate(time_s, self._pulses), self._long.rate(time_s, self._pulses)
        few = long * _SPAN_S < _LEAST_PULSES and short > 0.0
        return 60.0 * (long if few else short) / self._pulses_per_turn

    def _between(self, before: int, count: int, expected: float) -> int:
        pulses = (count - before) % self._modulus
        if count >= before or self._modulus == self._values or not expected:
            return pulses
        others = (count - before) % self._values
        return others if abs(others - expected) < abs(pulses - expected) else pulses
