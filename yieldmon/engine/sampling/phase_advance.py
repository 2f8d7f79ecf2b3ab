"""How fast the phase of the grain's pulses advances against that of the reported elevator speed.

The phase of a window's pulses is counted along the chain by the reported speed. Where this speed is wrong, the phase advances by
the same part of a turn from each second to the next. Geometry and chain do not change within hours, so the relative error of the
speed stays as it was when grain was first seen, unless chain or belt begin to slip, or the reported speed stays while that of the
elevator changes.
"""

from __future__ import annotations

from cmath import phase
from collections import deque
from math import inf, pi
from statistics import median

from yieldmon.engine.sampling.windows import Window
from yieldmon.physics.machine import Machine

_SECONDS = 10
"""Successive advances that are averaged."""
_ALIGNED = 0.9
"""Least length of the mean of their turns, each of length 1: 0 for chance, 1 for a steady advance."""
_FIRST, _LEAST = 30, 10
"""Errors from when grain was first seen, whose median is compared with, and how many there must be."""
_CHANGED, _GONE = 0.015, 0.0075
"""Change of the relative error from which the speed counts as changed, and below which it no longer does."""
_WRONG = 0.05
"""Least relative error of a speed that is wrong by itself: the geometry in a machine file may be off by some percent."""
_LONG_S = 600.0
"""Time without grain in which chain or speed sensor may have been repaired."""


class _Wave:
    """The advances of one wave of the pattern; number: of its turns in a pattern."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._turns: deque[complex] = deque(maxlen=_SECONDS)
        self._first: list[float] = []
        self._usual = 0.0

    def clear(self) -> None:
        self._turns.clear()

    def forget(self) -> None:
        self._first = []

    def see(self, window: Window, last: Window) -> bool:
        """Whether there are enough advances."""
        turn = window.harmonics_mv[self.number - 1] * last.harmonics_mv[self.number - 1].conjugate()
        self._turns.append(turn / abs(turn) if turn else 0j)
        return len(self._turns) == _SECONDS

    def error(self, patterns: float) -> float | None:
        """Relative error of the speed; None where the phase does not advance steadily. patterns: that pass in a second."""
        mean = sum(self._turns) / _SECONDS
        return phase(mean) / (2.0 * pi * patterns * self.number) if abs(mean) > _ALIGNED else None

    def change(self, error: float | None, *, wrong: bool) -> float | None:
        """The change of the error since grain was first seen; None where it is not known. wrong: the speed is so by itself."""
        if error is None:
            return None
        if len(self._first) < _FIRST and not wrong:
            self._first.append(error)
            self._usual = median(self._first)
        return error - self._usual if len(self._first) >= _LEAST else None


class PhaseAdvance:
    """Follows the waves of the pattern and of the paddles: the paddles' is stronger, the pattern's does not alias below 8 %.

    Attributes
    ----------
    wrong : bool
        Whether the reported speed was wrong by more than machine files are, by the last ten successive windows.
    change : float
        Change of the relative error of the reported speed since grain was first seen, by these; above 0: the pulses come faster.
        0 for none.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._pattern, self._paddles = _Wave(1), _Wave(len(machine.paddle_spacings_m))
        self._last: Window | None = None
        self._seen_s = inf
        self.wrong = False
        self.change = 0.0

    def see(self, window: Window, *, pulses: bool) -> None:
        """A further window with a force, whole. pulses: of grain, not of vibration beside something that lies on the plate."""
        if not pulses:
            self._last = None
            return
        last, self._last = self._last, window
        if window.end_s - self._seen_s > _LONG_S:
            self._pattern.forget()
            self._paddles.forget()
            self.change = 0.0
        self._seen_s = window.end_s
        if last is None or last.end_s != window.start_s or not (last.harmonics_mv and window.harmonics_mv):
            self._pattern.clear()
            self._paddles.clear()
            return
        resolved = self._paddles.number <= min(len(last.harmonics_mv), len(window.harmonics_mv))
        by_paddles = resolved and self._paddles.see(window, last)
        if not self._pattern.see(window, last):
            return
        speed_m_s = float(self._machine.paddle_speed_m_s(window.speed_rad_s))
        patterns = speed_m_s * (window.end_s - window.start_s) / self._machine.pattern_length_m
        error = self._pattern.error(patterns)
        self.wrong = error is not None and abs(error) > _WRONG
        of_paddles = self._paddles.error(patterns) if by_paddles else None
        self._compare(self._pattern.change(error, wrong=self.wrong), self._paddles.change(of_paddles, wrong=self.wrong))

    def _compare(self, by_pattern: float | None, by_paddles: float | None) -> None:
        """Judge the changes by the two waves; None: not known."""
        far = by_pattern is not None and abs(by_pattern) > _CHANGED
        found = by_pattern if far or by_paddles is None else by_paddles
        if found is not None:
            self.change = found if abs(found) > (_GONE if self.change else _CHANGED) else 0.0
