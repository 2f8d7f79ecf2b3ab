"""What python-can's reader of Vector's .asc leaves open: times since the line before, as the header may say, and lines that it
passes over without a word."""

from __future__ import annotations

import re

_HEADER = re.compile(r"\s*base\s+(?:hex|dec)\s+timestamps\s+(absolute|relative)\b", re.IGNORECASE)
_TIME = re.compile(r"\s*(\d{1,12}\.\d{1,9})(?=\s)")
_NS_PER_S = 1_000_000_000
_FRAME = re.compile(r"\d+\.\d+\s+(?:\d+\s+(?:\w+\s+(?:Tx|Rx)|ErrorFrame)|CANFD)", re.IGNORECASE | re.ASCII)
"""What python-can takes for a frame."""
_NUMBERED = re.compile(r"[\d(]")
_EVENT = re.compile(r"\d{1,12}\.\d{1,9}(?:\s|$)")
_OF_AN_IDENTIFIER = re.compile(r"\d{1,12}\.\d{1,9}\s+\d{1,3}\s+[0-9A-F]{1,8}x?\s", re.IGNORECASE)


def unread(line: str) -> str | None:
    """What is wrong with a line that should be a frame and is none to python-can, which passes it over; None for a frame, a line
    of the header and an event of another kind."""
    text = line.strip()
    if _FRAME.match(text) or not _NUMBERED.match(text):
        return None
    if _EVENT.match(text) and not _OF_AN_IDENTIFIER.match(text):
        return None
    return f"{text[:60]!r} is no frame as .asc has it"


def is_frame(start: bytes) -> bool:
    """Whether a file that starts so begins with a frame, without a header."""
    return _FRAME.match(start.decode("ascii", errors="replace").lstrip()) is not None


class Times:
    """Called with each line in order, gives it with a time from the beginning.

    Source: Vector, "CAN ASC logging file format": `timestamps relative` are times since the previous event, whatever it is.
    """

    def __init__(self) -> None:
        self._since_line_before = False
        self._now_ns = 0

    def __call__(self, line: str) -> str:
        """The line as it is under `timestamps absolute`."""
        header = _HEADER.match(line)
        if header is not None:
            self._since_line_before = header[1].lower() == "relative"
            return line
        time = _TIME.match(line) if self._since_line_before else None
        if time is None:
            return line
        self._now_ns += round(float(time[1]) * _NS_PER_S)
        whole_s, rest_ns = divmod(self._now_ns, _NS_PER_S)
        return f"{whole_s}.{rest_ns:09d}{line[time.end() :]}"
