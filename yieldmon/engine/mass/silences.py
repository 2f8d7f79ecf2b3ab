"""Silences of the sensors in which no grain comes: a load's begin, while their nodes still wake and no zero is known yet, and
pauses."""

from __future__ import annotations

from enum import Enum, auto
from math import inf, isfinite

_LONGEST_SILENCE_S, _LONGEST_WAKING_S = 60.0, 3.0
"""How long all sensors' nodes may be silent at a load's begin, and one of them after another: assumed, by no study."""
_LONGEST_ZEROING_S, _LONGEST_SPIN_UP_S = 4.5, 6.0
"""How long the elevator may turn at a load's begin until its first zero, at a speed at which one is taken: three seconds that are
seen to be empty; and before, while it gets up to that speed."""


class Missing(Enum):
    """What a second without a flow had of its inputs."""

    ALL = auto()
    """No impact sample, and no elevator speed above 0."""
    SOME = auto()
    ZERO = auto()
    """Samples and speed were there, and no zero to take off."""
    ZERO_STANDING = auto()
    """Of such a second: the elevator stood."""
    ZERO_OUT_OF_RANGE = auto()
    """Of such a second: the elevator turned at a speed at which no zero is taken."""

    HIDDEN = auto()
    """Of such a second: nothing, but its zero is suspect, and by the one before it there was grain."""

    @classmethod
    def of(cls, *, sampled: bool, speed: float, in_range: bool, zeroed: bool) -> Missing:
        """speed: of the elevator in any unit, nan where it is not known. in_range: grain is measured at it. zeroed: a zero was
        known."""
        if not sampled and not speed > 0.0:
            return cls.ALL
        if zeroed or not sampled or not isfinite(speed):
            return cls.SOME
        if speed == 0.0:
            return cls.ZERO_STANDING
        return cls.ZERO if in_range else cls.ZERO_OUT_OF_RANGE


class Silences:
    """The seconds of a load without sensors that are taken for time without grain.

    These are those at its begin in which no sensor sends yet, because its node wakes later than the bus, the next few in which
    one does and the other not, and those of the first zero; and a pause with the ignition off, of any length, if the elevator
    stood before and stands after it.
    """

    def __init__(self) -> None:
        self._silent_s = self._waking_s = self._zeroing_s = self._spin_up_s = 0.0
        self._stood = False
        """Whether the elevator stood when the sensors were last there."""

    def lacks_nothing(self, duration_s: float, missing: Missing | None, *, stands: bool = False) -> bool:
        """Whether a further second, or time without one, leaves the load whole. missing: None where its inputs were there.
        stands: whether the elevator stood in it."""
        if missing is None:
            ran_unseen = self._stood and not stands and self._silent_s > _LONGEST_SILENCE_S
            self._silent_s, self._waking_s = 0.0 if stands else inf, 0.0
            self._zeroing_s = self._spin_up_s = 0.0
            self._stood = stands
            return not ran_unseen
        unzeroed = missing in (Missing.ZERO, Missing.ZERO_STANDING, Missing.ZERO_OUT_OF_RANGE)
        if self._silent_s < inf and (unzeroed or self._zeroing_s > 0.0):
            if missing is Missing.ZERO_OUT_OF_RANGE:
                self._spin_up_s += duration_s
            elif missing is not Missing.ZERO_STANDING:
                # The second that ends with the zero has no flow either.
                self._zeroing_s += duration_s
            return self._zeroing_s <= _LONGEST_ZEROING_S and self._spin_up_s <= _LONGEST_SPIN_UP_S
        if missing is Missing.ALL and (self._stood or self._waking_s == 0.0):
            self._silent_s += duration_s
        else:
            self._waking_s += duration_s
        if self._waking_s > _LONGEST_WAKING_S:
            return False
        return self._silent_s < inf if self._stood else 0.0 < self._silent_s <= _LONGEST_SILENCE_S
