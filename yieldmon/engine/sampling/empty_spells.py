"""Difference of the empty plate from the zero in spells too short for a new zero, such as turns at the headland."""

from __future__ import annotations

from math import inf

_LEAST_WINDOWS = 3
"""Windows in a row without paddle pulses that are taken for an empty elevator."""
_SETTLED_WINDOWS = 5
"""The same until the last grain has left it."""


class EmptySpells:
    """Levels of spells without paddle pulses, which are too short to change the zero."""

    def __init__(self) -> None:
        self._windows = 0
        self._away_mv = inf
        """Smallest difference from the zero in the spell under way, mV."""
        self._found: tuple[float, float] | None = None
        """Level of the last spell that was long enough, mV, and when it was seen."""
        self.level_mv = 0.0
        """Level of the spell that is nearest to the zero, mV."""

    def interrupt(self) -> None:
        """End the spell: grain, or a window that cannot be judged."""
        self._windows, self._away_mv = 0, inf

    def see(self, level_mv: float, zero_mv: float, end_s: float) -> None:
        """A window without paddle pulses, by its mean level.

        The level nearest to the zero counts for a spell, because grain that still trickles raises the others.
        """
        self._windows += 1
        if abs(level_mv - zero_mv) < self._away_mv:
            self._away_mv, self.level_mv = abs(level_mv - zero_mv), level_mv
        if self._windows >= _LEAST_WINDOWS:
            self._found = (self.level_mv, end_s)

    @property
    def settled(self) -> bool:
        """Whether the spell under way has just lasted long enough for its level to be that of an empty plate."""
        return self._windows == _SETTLED_WINDOWS

    def departure_mv(self, zero_mv: float, known_s: float | None, trickle_mv: float) -> float:
        """How far the last spell's level is from the zero.

        Parameters
        ----------
        zero_mv : float
            In use.
        known_s : float or None
            When it was last taken or followed, s.
        trickle_mv : float
            Amplitude below which pulses are not detected: a trickle comes in short pulses, whose mean is below their amplitude.

        Returns
        -------
        float
            mV; what is left of it where the zero was still following the spell. 0 where the zero was updated since, and where a
            trickle of grain explains the difference.
        """
        if self._found is None:
            return 0.0
        level_mv, seen_s = self._found
        away_mv = abs(level_mv - zero_mv)
        return away_mv if away_mv > trickle_mv and (known_s is None or known_s <= seen_s) else 0.0
