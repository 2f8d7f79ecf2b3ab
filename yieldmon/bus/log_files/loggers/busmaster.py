"""Logs of BUSMASTER: the header says the base of identifiers and data, and what times mean.

    ***BUSMASTER Ver 2.4.0***
    ***PROTOCOL CAN***
    ***START DATE AND TIME 23:9:2015 22:17:28:928***          day:month:year hour:minute:second:millisecond
    ***HEX***                                                 or DEC
    ***SYSTEM MODE***                                         time of day; ABSOLUTE: since start; RELATIVE: since the last frame
    22:20:14:9920 Rx 1 0x21A s 8 FE 36 12 FE 69 05 07 AD      s, x (29 bits), sr, xr (remote)

Several sessions may follow each other in one file. Error frames are not logged.
"""

from __future__ import annotations

import re

import can

from yieldmon.units import S_PER_DAY

from .fields import Form, clock_s, data_bytes, message, whole

_START = re.compile(r"\*\*\*START DATE AND TIME (\d{1,4}):(\d{1,4}):(\d{1,4}) (\d{1,4}):(\d{1,4}):(\d{1,4}):(\d{1,4})\*\*\*")
_PROTOCOL = re.compile(r"\*\*\*PROTOCOL (\w+)\*\*\*")
_TIME = re.compile(r"(\d{1,4}):(\d\d):(\d\d):(\d{1,6})")
_BASES = {"***HEX***": 16, "***DEC***": 10}
_MODES = {"***SYSTEM MODE***": "system", "***ABSOLUTE MODE***": "absolute", "***RELATIVE MODE***": "relative"}
_TYPES = {"s": (False, False), "x": (True, False), "sr": (False, True), "xr": (True, True)}
"""Extended, remote."""
_FIELDS = 6


def begins(start: bytes) -> bool:
    """Whether a file that starts so is a log of BUSMASTER."""
    return start.startswith(b"***BUSMASTER")


class Busmaster:
    """Reads line by line."""

    def __init__(self) -> None:
        self._base: int | None = None
        self._mode = ""
        self._protocol = "CAN"
        self._start_s = 0.0
        self._last_s: float | None = None

    def __call__(self, line: str) -> can.Message | None:
        """As fields.Parser."""
        line = line.strip()
        if line.startswith("***") or not line:
            self._header(line)
            return None
        if self._protocol != "CAN":
            raise ValueError(f"logged as protocol {self._protocol}; expected protocol CAN")
        if self._base is None or not self._mode:
            raise ValueError("no header says whether numbers are HEX or DEC, and times SYSTEM, ABSOLUTE or RELATIVE")
        fields = line.split()
        if len(fields) < _FIELDS or fields[4].lower() not in _TYPES:
            raise ValueError(f"{line[:40]!r} is not a BUSMASTER line: time, Rx or Tx, channel, identifier, type, length, bytes")
        time_s = self._time_s(fields[0])
        is_extended, is_remote = _TYPES[fields[4].lower()]
        form = Form(whole(fields[3], "identifier", self._base), is_extended, is_rx=fields[1].lower() == "rx", is_remote=is_remote)
        data = b"" if is_remote else data_bytes(fields[_FIELDS:], self._base)
        return message(time_s, whole(fields[2], "channel"), form, data, whole(fields[5], "length"))

    def _header(self, line: str) -> None:
        self._base = _BASES.get(line, self._base)
        self._mode = _MODES.get(line, self._mode)
        if found := _PROTOCOL.fullmatch(line):
            self._protocol = found[1]
        elif found := _START.fullmatch(line):
            day, month, year, hour, minute, second, milliseconds = map(int, found.groups())
            self._start_s = clock_s(year, month, day, hour, minute, second) + milliseconds / 1e3
            self._last_s = None

    def _time_s(self, text: str) -> float:
        found = _TIME.fullmatch(text)
        if found is None:
            raise ValueError(f"time {text[:20]!r} is not hours:minutes:seconds:fraction")
        hours, minutes, whole_s, fraction = found.groups()
        since_s = int(hours) * 3600 + int(minutes) * 60 + int(whole_s) + int(fraction) / 10 ** len(fraction)
        if self._mode == "system":
            # The day is that on which the time of day is nearest to the frame before.
            near_s = self._start_s if self._last_s is None else self._last_s
            midnight_s = near_s - near_s % S_PER_DAY
            self._last_s = midnight_s + since_s + S_PER_DAY * round((near_s - midnight_s - since_s) / S_PER_DAY)
        elif self._mode == "absolute" or self._last_s is None:
            self._last_s = self._start_s + since_s
        else:
            self._last_s += since_s
        return self._last_s
