"""CSV that Kvaser's converters make of Memorator and CanKing logs ("CAN frames in CSV format").

The lines before the heading say whether identifiers and data are decimal, and when the logging began::

    CSV CAN data
    Converted from Kvaser Memorator at,2023-08-14 16:02:11
    Format of data field,DEC
    Format of id field,DEC
    Timestamp Offset,             0.00000,seconds
    Logging started at,2023-08-14 09:15:02
    Time,Channel,id,Flags,DLC,Data0,Data1,Data2,Data3,Data4,Data5,Data6,Data7,Counter,AbsTime
    0.00251,1,419360279,4,8,128,62,0,255,255,255,255,255,1,2023-08-14 09:15:02

Flags are decimal, those of Kvaser's CANlib. An error frame has neither identifier nor length. Times are
seconds since the logging began.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import can

from yieldmon.identifiers import CLASSIC_BYTES

from .fields import (
    Form,
    clock_s,
    data_bytes,
    error_frame,
    fd_length,
    message,
    require_as_many,
    require_columns,
    seconds,
    whole,
)

_FIRST_LINE = "CSV CAN data"
_NEEDED = ("time", "channel", "id", "flags", "dlc", "counter")
_FORMAT = re.compile(r"Format of (data|id|PGN) field(.)(HEX|DEC)\b")
_STARTED = re.compile(r"Logging started at.(\d{4})-(\d\d)-(\d\d) (\d\d):(\d\d):(\d\d)")
_BASES = {"HEX": 16, "DEC": 10}
_LONGEST_HEADER = 40
"""Lines."""

# Of canlib.h (canMSG_*, canMSGERR_*, canFDMSG_*).
_REMOTE, _EXTENDED, _ERROR, _SENT, _REQUESTED = 0x01, 0x04, 0x20, 0x40, 0x80
_OVERRUN, _FD, _BIT_RATE_SWITCH, _ERROR_STATE = 0x600, 0x10000, 0x20000, 0x40000


def parser(first_line: str, lost: Callable[[int], None]) -> Kvaser | None:
    """The reader of the lines after this one; None where no CSV of Kvaser's begins so. lost: called with 1 for each frame before
    which the logger reports lost frames."""
    return Kvaser(lost) if first_line.strip() == _FIRST_LINE else None


class Kvaser:
    """Reads line by line, as the header says."""

    def __init__(self, lost: Callable[[int], None]) -> None:
        self._lost = lost
        self._bases: dict[str, int] = {}
        self._separator = ","
        self._start_s = 0.0
        self._place: dict[str, int] = {}
        self._data_at: list[int] = []
        self._columns = self._header_lines = 0

    def __call__(self, line: str) -> can.Message | None:
        """As fields.Parser."""
        if self._columns:
            return self._frame(line) if line.strip() else None
        self._header_lines += 1
        if self._header_lines > _LONGEST_HEADER:
            raise ValueError("no line begins Time, Channel, id, Flags, DLC; a Kvaser CSV file needs its heading")
        if found := _FORMAT.match(line):
            self._separator = found[2]
            self._bases[found[1]] = _BASES[found[3]]
        elif found := _STARTED.match(line):
            self._start_s = clock_s(*(int(part) for part in found.groups()))
        elif line.lower().startswith(f"time{self._separator}channel"):
            self._heading(line)
        return None

    def _heading(self, line: str) -> None:
        columns = [column.strip().lower() for column in line.split(self._separator)]
        if "pgn" in columns:
            raise ValueError("has parameter groups in place of identifiers; convert the log without the J1939 option")
        require_columns(columns, _NEEDED)
        if not {"id", "data"} <= self._bases.keys():
            raise ValueError("does not say whether identifiers and data are hexadecimal; convert the log with its header")
        self._place = {name: columns.index(name) for name in _NEEDED}
        self._data_at = [place for place, name in enumerate(columns) if re.fullmatch(r"data\d+", name)]
        self._columns = len(columns)

    def _frame(self, line: str) -> can.Message | None:
        fields = [field.strip() for field in line.split(self._separator)]
        require_as_many(fields, self._columns)
        text = {name: fields[place] for name, place in self._place.items()}
        flags, channel = whole(text["flags"], "flags"), whole(text["channel"], "channel")
        time_s = self._start_s + seconds(text["time"])
        if flags & _OVERRUN:
            self._lost(1)
        if flags & _ERROR:
            return error_frame(time_s, channel)
        if flags & _REQUESTED and not flags & _SENT:
            # The transmission has a line of its own.
            return None
        is_fd = bool(flags & _FD)
        code = whole(text["dlc"], "length")
        length = fd_length(code) if is_fd else min(code, CLASSIC_BYTES)
        if length > len(self._data_at):
            raise ValueError(f"{length} bytes, of which the log holds {len(self._data_at)}; convert it with more data bytes")
        form = Form(
            whole(text["id"], "identifier", self._bases["id"]),
            bool(flags & _EXTENDED),
            is_rx=not flags & _SENT,
            is_remote=bool(flags & _REMOTE),
            is_fd=is_fd,
            bit_rate_switch=bool(flags & _BIT_RATE_SWITCH),
            error_state=bool(flags & _ERROR_STATE),
        )
        data = b"" if form.is_remote else data_bytes([fields[at] for at in self._data_at[:length]], self._bases["data"])
        return message(time_s, channel, form, data, length)
