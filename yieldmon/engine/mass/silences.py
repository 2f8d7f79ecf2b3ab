"""Times without measurement in which no grain can have come: the begin of a load, until all nodes send and a zero is known, and
pauses."""

from __future__ import annotations

from enum import Enum, auto
from math import inf, isfinite

_LONGEST_SILENCE_S, _LONGEST_WAKING_S = 60.0, 3.0
"""How long all nodes may be silent at the begin of a load, and then one of them alone: assumed, without a study."""
_LONGEST_ZEROING_S, _LONGEST_SPIN_UP_S = 4.5, 6.0
"""How long the elevator may turn in its speed range until the first zero (three empty seconds), and before that until it reaches
its speed range."""


class Missing(Enum):
    """Which inputs of a second without a flow were missing."""

    ALL = auto()
    """No impact sample, and no elevator speed above 0."""
    SOME = auto()
    """Any other combination."""
    ZERO = auto()
    """The zero: samples and speed were there, the elevator turned in its speed range."""
    ZERO_STANDING = auto()
    """The zero, while the elevator stood."""
    ZERO_OUT_OF_RANGE = auto()
    """The zero, while the elevator turned at a speed at which none is taken."""
    HIDDEN = auto()
    """None, but the zero is suspect, and by the one before it there was grain."""

    @classmethod
    def of(cls, *, sampled: bool, speed: float, in_range: bool, zeroed: bool) -> Missing:
        """What is missing, from sampled (impact samples came), speed (of the elevator in any unit, nan where not known), in_range
        (grain is measured at that speed) and zeroed (a zero was known)."""
        if not sampled and not speed > 0.0:
            return cls.ALL
        if zeroed or not sampled or not isfinite(speed):
            return cls.SOME
        if speed == 0.0:
            return cls.ZERO_STANDING
        return cls.ZERO if in_range else cls.ZERO_OUT_OF_RANGE


class Silences:
    """The seconds of a load without measurement that are taken for time without grain.

    At its begin: the seconds in which no sensor sends yet, because nodes wake later than the bus, the next few in which only one
    sends, and those of the first zero. Later: a pause with the ignition off, of any length, if the elevator stood before and
    stands after it.
    """

    def __init__(self) -> None:
        self._silent_s = self._waking_s = self._zeroing_s = self._spin_up_s = 0.0
        self._stood = False
        """Whether the elevator stood when the sensors last sent."""

    def lacks_nothing(self, duration_s: float, missing: Missing | None, *, stands: bool = False) -> bool:
        """Whether the load is still complete after a further second. missing: None where all inputs were there. stands: the
        elevator stood in it."""
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
                # The second at whose end the zero is taken has no flow either.
                self._zeroing_s += duration_s
            return self._zeroing_s <= _LONGEST_ZEROING_S and self._spin_up_s <= _LONGEST_SPIN_UP_S
        if missing is Missing.ALL and (self._stood or self._waking_s == 0.0):
            self._silent_s += duration_s
        else:
            self._waking_s += duration_s
        if self._waking_s > _LONGEST_WAKING_S:
            return False
        return self._silent_s < inf if self._stood else 0.0 < self._silent_s <= _LONGEST_SILENCE_S
