"""Mass that may have come in seconds that were not measured.

It is in no load. As much as would have come if grain had gone on at the mean of the flows before and after is one standard
deviation of the load's mass. All of it is missing, never too much, so several such times add, also over a load.
"""

from __future__ import annotations

from dataclasses import dataclass

_SHORTEST_STOP_S, _LONGEST_STOP_S = 2.0, 3600.0
"""Of a run for which grain may have gone on: of a shorter one no whole second is missing, of a longer one the clock may have been
another."""


@dataclass(frozen=True, slots=True)
class FlowAtStop:
    """Flow, kg/s, with which a run ended, and bus time, s, of the end of its last window."""

    time_s: float
    flow_kg_s: float


@dataclass(slots=True)
class UnseenMass:
    """Of the seconds since the last one that was measured. load_kg, total_kg: standard deviation of the open load's mass and of
    the total by all of those before, since the start."""

    load_kg: float = 0.0
    total_kg: float = 0.0
    _before_kg_s: float = 0.0
    _seconds: float = 0.0
    _whole: bool = True
    _stopped: bool = False

    @property
    def before_kg_s(self) -> float:
        """Flow of the last second that was measured."""
        return self._before_kg_s

    def resume(self, stopped_s: float, before_kg_s: float) -> None:
        """A run before ended so long before this one, with such a flow."""
        if stopped_s < _SHORTEST_STOP_S:
            return
        self._seconds, self._before_kg_s = min(stopped_s, _LONGEST_STOP_S), before_kg_s
        self._whole, self._stopped = False, True

    def missing(self, seconds: float, *, whole: bool) -> None:
        """So many more were not measured. whole: and no grain can have come in them."""
        self._seconds += seconds
        self._whole = self._whole and whole

    def measured(self, rate_kg_s: float, *, whole: bool = True) -> float:
        """A second was measured; returns what may have come unseen before it, kg. rate_kg_s: 0 without grain. whole: it shows
        that none can have come."""
        between_kg_s = 0.5 * (self._before_kg_s + rate_kg_s)
        if self._stopped:
            # The machine may have stopped as well.
            between_kg_s = min(self._before_kg_s, rate_kg_s)
        return self._ended(between_kg_s, rate_kg_s, whole=whole)

    def cut(self) -> float:
        """The load ends, what comes after it is not known; returns what may have come unseen, kg."""
        return self._ended(0.0 if self._stopped else self._before_kg_s, self._before_kg_s, whole=True)

    def _ended(self, rate_kg_s: float, before_kg_s: float, *, whole: bool) -> float:
        missed_kg = 0.0 if self._whole and whole else self._seconds * rate_kg_s
        self._before_kg_s, self._seconds, self._whole, self._stopped = before_kg_s, 0.0, True, False
        return missed_kg
