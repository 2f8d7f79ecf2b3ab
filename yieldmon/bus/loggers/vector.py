"""Times of Vector's .asc, which count from the beginning of the measurement or, as the header may say, from the line before."""

from __future__ import annotations

import re

_HEADER = re.compile(r"\s*base\s+(?:hex|dec)\s+timestamps\s+(absolute|relative)\b", re.IGNORECASE)
_TIME = re.compile(r"\s*(\d{1,12}\.\d{1,9})(?=\s)")
_NS_PER_S = 1_000_000_000


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
