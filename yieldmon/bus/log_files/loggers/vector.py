"""Vector's .asc, as CANoe, CANalyzer, python-can and CANedge's `mdf2asc` write it.

    date Sam Sep 30 10:06:13.191 PM 2017
    base hex  timestamps absolute                           or dec; relative: since the line before, whatever it is
       2.501000 1  ErrorFrame
       2.510001 1  100        Rx   d 8 00 01 02 03 04 05 06 07  Length = 0 BitCount = 64 ID = 256
       2.515002 1  EEC1x      Rx   d 8 00 01 02 03 04 05 06 07  Length = 0 BitCount = 64 ID = 217056256x   with names logged
       2.520002 1  18FEF100x  Tx   r 8
       4.876870 CANFD   1 Rx   300  [name]  1 0 9 12 01 02 03 04 05 06 07 08 09 0A 0B 0C  102203 133 303000 ...

Times count from the date of the header, taken as UTC, or from that of the trigger block with which the measurement starts;
without one they are as they stand. The header may lack any of its lines. Lines of other buses, comments, statistics and other
events are not frames; what looks like a frame and cannot be read is reported, as is a message's name without its number behind
the data. `TxRq` is a frame that was only asked for; the one that was sent has a line of its own.

Source: Vector, "CAN ASC logging file format".
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import can

from yieldmon.identifiers import CLASSIC_BYTES, FD_LENGTHS

from .fields import Form, clock_s, data_bytes, error_frame, fd_length, message, seconds, whole

_HEADER = re.compile(r"base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?\b", re.IGNORECASE)
_DATE = re.compile(
    r"(date|begin\s+triggerblock)\s+\S+\s+(\w+)\.?\s+(\d{1,2})\s+(\d{1,2}):(\d{1,2}):(\d{1,2})(?:\.(\d{1,6}))?"
    r"(?:\s+(?:([ap])m|(?:(v)or|(n)ach)m\.?))?\s+(\d{4})\b",
    re.IGNORECASE,
)
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_DATE_LINE = re.compile(r"date\s+\S.*\d", re.IGNORECASE)
_MONTHS_ELSEWHERE = {"jän": 1, "mär": 3, "mrz": 3, "mae": 3, "mai": 5, "okt": 10, "dez": 12}
_START = re.compile(r"0+\.0+\s+Start of measurement", re.IGNORECASE)
_TIME = re.compile(r"(\d{1,12}\.\d{1,9})(?=\s)")
_NS_PER_S = 1_000_000_000
_FRAME = re.compile(r"\d+\.\d+\s+(?:\d+\s+(?:\w+\s+(?:Tx|Rx)|ErrorFrame)|CANFD\b)", re.IGNORECASE | re.ASCII)
_NUMBERED = re.compile(r"[\d(]")
_EVENT = re.compile(r"\d{1,12}\.\d{1,9}(?:\s|$)")
_OF_AN_IDENTIFIER = re.compile(r"\d{1,12}\.\d{1,9}\s+\d{1,3}\s+[0-9A-F]{1,8}x?\s", re.IGNORECASE)
_BYTE = re.compile(r"[0-9A-F]{1,3}", re.IGNORECASE | re.ASCII)
_NUMBER = re.compile(r"\bID\s*=\s*(\d{1,10})(x?)", re.IGNORECASE | re.ASCII)
"""Behind a classic frame's data: its identifier in decimals, whatever the base, and where messages are logged by name."""
_NAME = re.compile(r"[^\W\d]\w*")
_ASKED_FOR = "txrq"
_FD_FLAG = 1 << 12
"""In the flags behind a CANFD line's data: set for a frame of CAN FD, not for a classic one on such a channel."""
_FLAGS_AT = 2


class Vector:
    """Reads line by line."""

    def __init__(self) -> None:
        self._base = 16
        self._since_line_before = False
        self._now_ns = 0
        self._start_s = 0.0
        self._triggered_s: float | None = None

    def __call__(self, line: str) -> can.Message | None:
        """As fields.Parser."""
        text = line.strip()
        header = _HEADER.match(text)
        if header is not None:
            self._base = {"hex": 16, "dec": 10}[header[1].lower()]
            self._since_line_before = (header[2] or "").lower() == "relative"
            return None
        date = _DATE.match(text)
        if date is not None and self._take_date(date):
            return None
        if _DATE_LINE.match(text):
            raise ValueError(f"the date {text[4:].strip()[:40]!r} is not understood; the times count from 0")
        time_s = self._time_s(text)
        if _FRAME.match(text) is None:
            if self._triggered_s is not None and _START.match(text):
                self._start_s = self._triggered_s
            if problem := _unread(text):
                raise ValueError(problem)
            return None
        fields = text.split()
        time_s = self._start_s + (seconds(fields[0]) if time_s is None else time_s)
        if fields[1].lower() == "canfd":
            return self._of_fd_channel(time_s, fields[2:])
        return self._of_classic_channel(time_s, fields[1:])

    def _take_date(self, date: re.Match[str]) -> bool:
        """False for a month of another language."""
        of, name, day, hour, minute, second, part, *halves, year = date.groups()
        half = "".join(word or "" for word in halves).lower()
        short = name.lower()[:3]
        month = _MONTHS.index(short) + 1 if short in _MONTHS else _MONTHS_ELSEWHERE.get(short)
        if month is None:
            return False
        hours = int(hour) % 12 + 12 * (half in ("p", "n")) if half else int(hour)
        # python-can writes milliseconds without leading zeros.
        fraction_s = int(part or 0) / 10.0 ** max(3, len(part or ""))
        at_s = clock_s(int(year), month, int(day), hours, int(minute), int(second)) + fraction_s
        if of.lower() == "date":
            self._start_s = at_s
        else:
            self._triggered_s = at_s
        return True

    def _time_s(self, text: str) -> float | None:
        """Time from the beginning where the line has one since the line before; None where it is as it stands."""
        time = _TIME.match(text) if self._since_line_before else None
        if time is None:
            return None
        self._now_ns += round(float(time[1]) * _NS_PER_S)
        return self._now_ns / _NS_PER_S

    def _of_classic_channel(self, time_s: float, fields: Sequence[str]) -> can.Message | None:
        """Fields: channel, identifier, direction, d or r, length, bytes."""
        channel = whole(fields[0], "channel") - 1
        if fields[1].lower() == "errorframe":
            return error_frame(time_s, channel)
        direction, kind = fields[2].lower(), "".join(fields[3:4]).lower()
        if direction == _ASKED_FOR:
            return None
        if kind not in ("d", "r"):
            raise ValueError(f"{' '.join(fields)[:40]!r} is neither a data (d) nor a remote (r) frame")
        form = self._named_form(fields[1], direction, fields[5:])._replace(is_remote=kind == "r")
        if form.is_remote:
            length = whole(fields[4], "length", self._base) if len(fields) > 4 and fields[4].isdigit() else 0
            return message(time_s, channel, form, b"", length)
        length = _length("".join(fields[4:5]), self._base, _bytes_of(fields[5:]))
        data = data_bytes(fields[5 : 5 + length], self._base)
        return message(time_s, channel, form._replace(is_fd=length > CLASSIC_BYTES), data, length)

    def _of_fd_channel(self, time_s: float, fields: Sequence[str]) -> can.Message | None:
        """Fields: channel, direction, identifier, perhaps a name, bit rate switch, error state, length code, length, bytes, and
        what else there is to say."""
        channel, direction = whole(fields[0], "channel") - 1, fields[1].lower()
        if fields[2].lower() == "errorframe":
            return error_frame(time_s, channel)
        rest = fields[3:] if fields[3].isdigit() else fields[4:]
        if direction == _ASKED_FOR:
            return None
        if len(rest) < 4:
            raise ValueError(f"{' '.join(fields)[:40]!r} is not a frame of .asc")
        code, length = whole(rest[2], "length code", self._base), whole(rest[3], "length")
        data, behind = rest[4 : 4 + length], rest[4 + length :]
        flags = whole(behind[_FLAGS_AT], "flags", 16) if len(behind) > _FLAGS_AT else _FD_FLAG
        form = self._form(fields[2], direction)._replace(
            is_remote=length == 0 and code > 0,
            is_fd=bool(flags & _FD_FLAG) or length > CLASSIC_BYTES,
            bit_rate_switch=rest[0] == "1",
            error_state=rest[1] == "1",
        )
        return message(
            time_s, channel, form, data_bytes(data, self._base), min(code, CLASSIC_BYTES) if form.is_remote else length
        )

    def _named_form(self, identifier: str, direction: str, behind: Sequence[str]) -> Form:
        """As _form(), also for a message's name, which may look like a number, as EEC1 does: the ID behind the data decides."""
        number = _NUMBER.search(" ".join(behind)) if _NAME.fullmatch(identifier) else None
        if number is not None:
            return Form(int(number[1]), bool(number[2]), is_rx=direction == "rx")
        try:
            return self._form(identifier, direction)
        except ValueError as error:
            if _NAME.fullmatch(identifier):
                raise ValueError(f"{identifier[:40]!r} is a message's name; log identifiers as numbers") from error
            raise

    def _form(self, identifier: str, direction: str) -> Form:
        is_extended = identifier[-1:].lower() == "x"
        number = whole(identifier[:-1] if is_extended else identifier, "identifier", self._base)
        return Form(number, is_extended, is_rx=direction == "rx")


def _bytes_of(fields: Sequence[str]) -> int:
    """How many bytes the fields begin with."""
    return next((place for place, field in enumerate(fields) if _BYTE.fullmatch(field) is None), len(fields))


def _length(text: str, base: int, there: int) -> int:
    """Bytes of a frame with this length field, where `there` bytes follow. A classic frame's code may be up to 15, which is eight
    bytes. CANedge's writer has frames of CAN FD like classic ones, their code in decimals; an old one of python-can has the
    length itself."""
    code = whole(text, "length", base)
    if code <= CLASSIC_BYTES:
        return code
    if there == CLASSIC_BYTES and code < len(FD_LENGTHS):
        return CLASSIC_BYTES
    codes = {code, int(text)} if text.isdigit() else {code}
    if there not in FD_LENGTHS or there not in codes | {fd_length(one) for one in codes if one < len(FD_LENGTHS)}:
        raise ValueError(f"{there} bytes of data where the length says {text[:20]}")
    return there


def _unread(text: str) -> str | None:
    """Why a line that should be a frame cannot be read; None for a line of the header and another kind of event."""
    if not _NUMBERED.match(text):
        return None
    if _EVENT.match(text) and not _OF_AN_IDENTIFIER.match(text):
        return None
    return f"{text[:60]!r} is not a frame of .asc"
