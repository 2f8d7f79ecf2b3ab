"""Logs of CSS Electronics' CL1000, CL2000 and CL3000: the header says when they begin and what separates their fields.

    # Logger type: CL2000
    # Time: 20170101T022232                           year, month, day, hour, minute, second
    # Value separator: ";"
    # Time separator: ""
    Timestamp;Type;ID;Data                            Lost and Length, too, where they were asked for
    01T022231683;8;7df;02010d5555555555               day, hour, minute, second, millisecond

A time may lack its day, or have its month and year as well; what it lacks is such that the time is nearest to that of the frame
before, or of the header. Type is 0, or 1 for 29 bits, of received frames, 8 or 9 of sent ones. A CL1000, which has no clock,
begins with the year 2000. Error frames are not logged.

Source: CSS Electronics, CLX000 documentation, "Log file".
"""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import can

from .fields import Form, extended, hex_bytes, message, require_as_many, require_columns, whole

_FIRST_LINE = "# Logger type:"
_TIME = re.compile(r"# Time: (\d{8})T(\d{6})\s*")
_SEPARATOR = re.compile(r"# Value separator: \"(.)\"\s*")
_NEEDED = ("Timestamp", "ID", "Data")
_TYPES = {"0": (False, True), "1": (True, True), "8": (False, False), "9": (True, False)}
"""29 bits, received."""
_OF_DAY, _OF_MONTH, _WHOLE = 9, 11, 17
"""Digits of a time from its hour, day or year on."""
_UNKNOWN = datetime.fromtimestamp(0, UTC)


def begins(start: bytes) -> bool:
    """Whether a file that starts so is one of these logs."""
    return start.startswith(_FIRST_LINE.encode())


class Clx000:
    """Reads line by line, as the header says. lost: called with the number of frames that the logger reports as lost."""

    def __init__(self, lost: Callable[[int], None]) -> None:
        self._lost = lost
        self._near = _UNKNOWN
        self._separator = ";"
        self._columns: list[str] = []
        self._second = ""

    def __call__(self, line: str) -> can.Message | None:
        """As fields.Parser."""
        line = line.strip()
        if line.startswith("#"):
            self._header(line)
        elif line and not self._columns:
            self._columns = self._heading(line)
        elif line:
            return self._frame(line)
        return None

    def _header(self, line: str) -> None:
        if line.startswith(_FIRST_LINE):
            self._near, self._columns, self._second = _UNKNOWN, [], ""
        elif time := _TIME.fullmatch(line):
            self._near = _moment(f"{time[1]}{time[2]}")
        elif separator := _SEPARATOR.fullmatch(line):
            self._separator = separator[1]

    def _heading(self, line: str) -> list[str]:
        columns = line.split(self._separator)
        require_columns(columns, _NEEDED, "Timestamp;Type;ID;Data")
        if self._near == _UNKNOWN:
            raise ValueError("no line of the header says when the log begins (# Time: 20170101T022232)")
        return columns

    def _frame(self, line: str) -> can.Message:
        fields = line.split(self._separator)
        require_as_many(fields, len(self._columns))
        of = dict(zip(self._columns, fields, strict=True))
        time_s, arbitration_id = self._time_s(of["Timestamp"]), whole(of["ID"], "identifier", 16)
        kind = of.get("Type", "0")
        if kind not in _TYPES:
            raise ValueError(f"type {kind[:20]!r} is not 0, 1, 8 or 9")
        is_marked, is_rx = _TYPES[kind]
        data = hex_bytes(of["Data"])
        form = Form(arbitration_id, extended(arbitration_id, marked=is_marked), is_rx)
        read = message(time_s, None, form, data, whole(of.get("Length", str(len(data))), "length"))
        self._lost(whole(of.get("Lost", "0"), "number of lost frames"))
        return read

    def _time_s(self, text: str) -> float:
        digits = "".join(character for character in text if character.isdigit())
        if len(digits) not in (_OF_DAY, _OF_MONTH, _WHOLE):
            raise ValueError(
                f"time {text[:30]!r} is not hours, minutes, seconds and milliseconds, with the day or the whole date before"
            )
        if digits[:-3] != self._second:
            self._near = self._nearest(digits[:-3])
            self._second = digits[:-3]
        return self._near.timestamp() + int(digits[-3:]) / 1000

    def _nearest(self, digits: str) -> datetime:
        whole_digits = _WHOLE - 3
        if len(digits) == whole_digits:
            return _moment(digits)
        by_month = len(digits) == _OF_MONTH - 3
        middle, step = (self._near.replace(day=15), timedelta(days=30)) if by_month else (self._near, timedelta(days=1))
        found = []
        for shift in (-step, timedelta(0), step):
            try:
                found.append(_moment((middle + shift).strftime("%Y%m%d")[: whole_digits - len(digits)] + digits))
            except (ValueError, OverflowError):
                # A month without this day, or beyond the last year.
                continue
        if not found:
            raise ValueError(f"time {digits} is not in the calendar")
        near = self._near
        return min(found, key=lambda moment: abs(moment - near))


def _moment(digits: str) -> datetime:
    return datetime.strptime(digits, "%Y%m%d%H%M%S").replace(tzinfo=UTC)
