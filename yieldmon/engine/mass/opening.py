"""How a load begins while the sensors' nodes still wake, and while no zero is known yet."""

from __future__ import annotations

from math import inf

_LONGEST_SILENCE_S, _LONGEST_WAKING_S = 60.0, 3.0
"""How long all sensors' nodes may be silent at a load's begin, and one of them after another: assumed, by no study."""
_LONGEST_ZEROING_S = 4.5
"""How long the elevator may turn at a load's begin until its first zero: three seconds that are seen to be empty, after one in
which it gets up to speed."""


class Opening:
    """The seconds at a load's begin that are taken for time without grain: those in which no sensor sends yet, because its node
    wakes later than the bus, the next few in which one does and the other not, and those of the first zero."""

    def __init__(self) -> None:
        self._silent_s = self._waking_s = self._zeroing_s = 0.0

    def lacks_nothing(
        self, duration_s: float, *, available: bool, silent: bool, unzeroed: bool = False, standing: bool = False
    ) -> bool:
        """Whether a further second leaves the load whole. available: its inputs were there. silent: no impact sample, and no
        elevator speed above 0. unzeroed: samples and speed were there, and no zero to take off. standing: of such a second, the
        elevator stood."""
        if available:
            self._silent_s, self._zeroing_s = inf, 0.0
            return True
        if self._silent_s < inf and (unzeroed or self._zeroing_s > 0.0):
            # The second that ends with the zero has no flow either.
            self._zeroing_s += 0.0 if standing else duration_s
            return self._zeroing_s <= _LONGEST_ZEROING_S
        if silent and self._waking_s == 0.0:
            self._silent_s += duration_s
        else:
            self._waking_s += duration_s
        return 0.0 < self._silent_s <= _LONGEST_SILENCE_S and self._waking_s <= _LONGEST_WAKING_S
