"""Ranges of the signals of the shipped DBC, for those who make frames without packing them.

Values that a signal cannot carry are "not available"; where the largest value of a signal is stands in the DBC and nowhere else.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache

from yieldmon.resources import shipped

SignalRanges = Mapping[str, Mapping[str, tuple[float, float]]]
"""Message -> signal -> smallest and largest value, in the signal's unit."""

_MESSAGE = r"^BO_ \d+ (?P<message>\w+)\s*:"
_SIGNAL = r"^\s+SG_ (?P<signal>\w+) [^\[\n]*\[(?P<low>[^|]+)\|(?P<high>[^\]]+)\]"
_LINE = re.compile(f"{_MESSAGE}|{_SIGNAL}", re.MULTILINE)


@cache
def signal_ranges() -> SignalRanges:
    """Ranges of the shipped DBC. Raises OSError."""
    found: dict[str, dict[str, tuple[float, float]]] = {}
    signals: dict[str, tuple[float, float]] = {}
    for line in _LINE.finditer(shipped("dbc/yieldmon.dbc").read_text(encoding="utf-8")):
        if line["message"]:
            signals = found.setdefault(line["message"], {})
        else:
            signals[line["signal"]] = float(line["low"]), float(line["high"])
    return found
