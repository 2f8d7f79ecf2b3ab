"""Whether the pulses' shape gives a volume flow."""

from __future__ import annotations

from enum import IntEnum


class ShapeVerdict(IntEnum):
    """Whether the pulses' shape gives a volume flow, or the reason why not."""

    NOT_LOOKED_AT = 0
    USED = 1
    NO_SAMPLES = 2
    NO_GRAIN = 3
    NOT_STILL = 4
    NO_PULSES = 5
    FEW_TURNS = 6
    OUTSIDE_CALIBRATION = 7
    NO_ZERO = 8
    SPEED_OUT_OF_RANGE = 9
