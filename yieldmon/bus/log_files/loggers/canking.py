"""Text logs of Kvaser's CanKing, of the hexadecimal numbers that it shows.

    Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir
     0    0CFBFFDB X       8  1B  31  20  EB  B3  FF  D9  FF     100.000139 R
     0    0000014B         1  00                                 101.570498 T
     0    00000000            ErrorFrame                         102.095270 R

Times count from the start. Flags: X 29 bits, R remote frame. A log with decimal numbers, whose identifiers have not eight digits,
is not read.
"""

from __future__ import annotations

import re

import can

from .fields import Form, data_bytes, error_frame, extended, message, seconds, whole

_HEADING = "Chn Identifier"
_FRAME = re.compile(
    r"(?P<channel>\d{1,3})\s+(?P<id>[0-9A-Fa-f]{8})\s+(?:(?P<flags>[A-Z]{1,4})\s+)?"
    r"(?:ErrorFrame|(?P<length>\d)(?P<data>(?:\s+[0-9A-Fa-f]{2}){0,8}))\s+(?P<time>\d{1,9}\.\d{1,9})\s+(?P<direction>[RT])"
)
_EXTENDED, _REMOTE = "X", "R"


def begins(start: bytes) -> bool:
    """Whether a file that starts so is a log of CanKing's."""
    return start.lstrip().startswith(_HEADING.encode())


def parse(line: str) -> can.Message | None:
    """As fields.Parser."""
    line = line.strip()
    if not line[:1].isdigit():
        return None
    found = _FRAME.fullmatch(line)
    if found is None:
        raise ValueError(
            f"{line[:60]!r} is not a CanKing frame with hexadecimal numbers: channel, eight digits, flags, length, bytes, time"
        )
    time_s, channel = seconds(found["time"]), whole(found["channel"], "channel")
    if found["length"] is None:
        return error_frame(time_s, channel)
    flags = set(found["flags"] or "")
    if not flags <= {_EXTENDED, _REMOTE}:
        raise ValueError(f"flags {found['flags']!r} are not known; expected X or R")
    arbitration_id = whole(found["id"], "identifier", 16)
    form = Form(
        arbitration_id,
        extended(arbitration_id, marked=_EXTENDED in flags),
        is_rx=found["direction"] == "R",
        is_remote=_REMOTE in flags,
    )
    return message(time_s, channel, form, data_bytes(found["data"].split()), whole(found["length"], "length"))
