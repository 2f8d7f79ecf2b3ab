"""How a load begins while the sensors' nodes still wake."""

from __future__ import annotations

from math import inf

_LONGEST_SILENCE_S, _LONGEST_WAKING_S = 60.0, 3.0
"""How long all sensors' nodes may be silent at a load's begin, and one of them after another: assumed, by no study."""


class Opening:
    """The seconds at a load's begin in which no sensor sends yet, because its node wakes later than the bus, and the next few in
    which one does and the other not: they are taken for time without grain."""

    def __init__(self) -> None:
        self._silent_s = self._waking_s = 0.0

    def lacks_nothing(self, duration_s: float, *, available: bool, silent: bool) -> bool:
        """Whether a further second leaves the load whole. available: its inputs were there. silent: no impact sample, and no
        elevator speed above 0."""
        if available:
            self._silent_s = inf
            return True
        if silent and self._waking_s == 0.0:
            self._silent_s += duration_s
        else:
            self._waking_s += duration_s
        return 0.0 < self._silent_s <= _LONGEST_SILENCE_S and self._waking_s <= _LONGEST_WAKING_S
