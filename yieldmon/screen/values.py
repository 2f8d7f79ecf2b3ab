"""Signal values as people read them."""

from __future__ import annotations

from enum import IntEnum

from yieldmon import frames
from yieldmon.bus.layout import SignalLayout
from yieldmon.frames import Unusable, Value

_PLACE_SCALE_DEG = 1e-5
"""Of latitude and longitude: a centimetre is 1e-7 deg."""

CODES: dict[str, type[IntEnum] | type] = {
    "SensorStatus": frames.SensorStatus,
    "ActuatorState": frames.ActuatorState,
    "CommandMode": frames.CommandMode,
    "TankScaleStatus": frames.ScaleStatus,
    "EstimateQuality": frames.EstimateQuality,
    "SweepState": frames.SweepState,
    "OperatingState": frames.OperatingState,
}


def code_name(signal: str, value: Value) -> str:
    """Name of a coded value in words, such as `not harvesting`."""
    if isinstance(value, Unusable):
        return "-" if value is frames.NOT_AVAILABLE else "error"
    codes = CODES.get(signal)
    try:
        return codes(value).name.lower().replace("_", " ") if codes else str(value)
    except ValueError:
        return str(value)


def text(signal: SignalLayout, value: Value) -> str:
    """A value with its unit; `-` for not available."""
    if isinstance(value, Unusable):
        return "-" if value is frames.NOT_AVAILABLE else "error"
    if signal.name in CODES:
        return code_name(signal.name, value)
    if isinstance(value, int):
        return f"{value}{signal.unit}"
    return f"{number(signal, value)} {signal.unit}".rstrip()


def number(signal: SignalLayout, value: float) -> str:
    """A value to as many digits as its resolution has, and no more than a reader wants; places on earth keep all of theirs."""
    finest = max(0, min(7, len(f"{signal.scale:.7f}".rstrip("0").partition(".")[2])))
    if signal.scale <= _PLACE_SCALE_DEG and signal.unit == "deg":
        return f"{value:.{finest}f}"
    size = abs(value)
    wanted = 1 if size >= 99.95 else 2 if size >= 9.995 else 3
    return f"{value:.{min(finest, wanted)}f}"
