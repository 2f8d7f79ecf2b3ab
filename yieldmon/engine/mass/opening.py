"""How a load begins while the sensors' nodes still wake, and while no zero is known yet."""

from __future__ import annotations

from enum import Enum, auto
from math import inf, isfinite

_LONGEST_SILENCE_S, _LONGEST_WAKING_S = 60.0, 3.0
"""How long all sensors' nodes may be silent at a load's begin, and one of them after another: assumed, by no study."""
_LONGEST_ZEROING_S = 4.5
"""How long the elevator may turn at a load's begin until its first zero: three seconds that are seen to be empty, after one in
which it gets up to speed."""


class Missing(Enum):
    """What a second without a flow had of its inputs."""

    ALL = auto()
    """No impact sample, and no elevator speed above 0."""
    SOME = auto()
    ZERO = auto()
    """Samples and speed were there, and no zero to take off."""
    ZERO_STANDING = auto()
    """Of such a second: the elevator stood."""

    @classmethod
    def of(cls, *, sampled: bool, speed: float, zeroed: bool) -> Missing:
        """speed: of the elevator in any unit, nan where it is not known. zeroed: a zero was known."""
        if not sampled and not speed > 0.0:
            return cls.ALL
        if zeroed or not sampled or not isfinite(speed):
            return cls.SOME
        return cls.ZERO if speed != 0.0 else cls.ZERO_STANDING


class Opening:
    """The seconds at a load's begin that are taken for time without grain: those in which no sensor sends yet, because its node
    wakes later than the bus, the next few in which one does and the other not, and those of the first zero."""

    def __init__(self) -> None:
        self._silent_s = self._waking_s = self._zeroing_s = 0.0

    def lacks_nothing(self, duration_s: float, missing: Missing | None) -> bool:
        """Whether a further second leaves the load whole. missing: None where its inputs were there."""
        if missing is None:
            self._silent_s, self._zeroing_s = inf, 0.0
            return True
        unzeroed = missing in (Missing.ZERO, Missing.ZERO_STANDING)
        if self._silent_s < inf and (unzeroed or self._zeroing_s > 0.0):
            # The second that ends with the zero has no flow either.
            self._zeroing_s += 0.0 if missing is Missing.ZERO_STANDING else duration_s
            return self._zeroing_s <= _LONGEST_ZEROING_S
        if missing is Missing.ALL and self._waking_s == 0.0:
            self._silent_s += duration_s
        else:
            self._waking_s += duration_s
        return 0.0 < self._silent_s <= _LONGEST_SILENCE_S and self._waking_s <= _LONGEST_WAKING_S
