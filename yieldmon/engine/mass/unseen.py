"""Mass that may have come in seconds that were not measured.

It is in no load. As much as would have come if grain had gone on at the mean of the flows before and after is one standard
deviation of the load's mass. All of it is missing, never too much, so several such times add, also over a load.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class UnseenMass:
    """Of the seconds since the last one that was measured. load_kg, total_kg: standard deviation of the open load's mass and of
    the total by all of those before, since the start."""

    load_kg: float = 0.0
    total_kg: float = 0.0
    _before_kg_s: float = 0.0
    _seconds: float = 0.0
    _whole: bool = True

    def missing(self, seconds: float, *, whole: bool) -> None:
        """So many more were not measured. whole: and no grain can have come in them."""
        self._seconds += seconds
        self._whole = self._whole and whole

    def measured(self, rate_kg_s: float, *, whole: bool = True) -> float:
        """A second was measured; returns what may have come unseen before it, kg. rate_kg_s: 0 without grain. whole: it shows
        that none can have come."""
        return self._ended(0.5 * (self._before_kg_s + rate_kg_s), rate_kg_s, whole=whole)

    def cut(self) -> float:
        """The load ends, what comes after it is not known; returns what may have come unseen, kg."""
        return self._ended(self._before_kg_s, self._before_kg_s, whole=True)

    def _ended(self, rate_kg_s: float, before_kg_s: float, *, whole: bool) -> float:
        missed_kg = 0.0 if self._whole and whole else self._seconds * rate_kg_s
        self._before_kg_s, self._seconds, self._whole = before_kg_s, 0.0, True
        return missed_kg
