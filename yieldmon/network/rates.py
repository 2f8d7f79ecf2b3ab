"""Budgets that keep what others ask of us bounded, and remember that they were exceeded."""

from __future__ import annotations

_HOLD_S = 3.0


class Budget:
    """So many a second on the average, and so many at once.

    Parameters
    ----------
    per_s : float
        Long-run rate, 1/s.
    at_once : float
        Largest burst.
    """

    def __init__(self, per_s: float, at_once: float) -> None:
        self._per_s = per_s
        self._most = at_once
        self._left = at_once
        self._at_s = float("-inf")
        self._exceeded_s = float("-inf")
        self.refused = 0
        """How many did not fit."""

    def take(self, now_s: float) -> bool:
        """Whether one more fits at now_s."""
        passed_s = max(0.0, now_s - self._at_s)
        self._left = min(self._most, self._left + passed_s * self._per_s) if passed_s < float("inf") else self._most
        self._at_s = max(self._at_s, now_s)
        if self._left >= 1.0:
            self._left -= 1.0
            return True
        self.refused += 1
        self._exceeded_s = now_s
        return False

    def exceeded(self, now_s: float) -> bool:
        """Whether something did not fit within the last three seconds before now_s."""
        return now_s - self._exceeded_s < _HOLD_S
