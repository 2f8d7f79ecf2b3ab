"""Traces of PEAK's programs (.trc), versions 1.0 to 2.1.

Each version has its columns; from 2.0 on the file names them by letter, here used for all:

    N number, O time offset in ms, T type, B bus, I identifier, d direction, R reserved, l length, L data length code, D data

    ;$FILEVERSION=1.1
    ;$STARTTIME=37704.5364870833                    days since 30 December 1899, local time
         1)      1059.9  Rx         0300  7  00 00 00 00 04 00 00
         6)      1349.2  Error      0008  4  00 19 08 08

Identifiers are hexadecimal, with more than four digits for 29 bits. Warnings, bus states, error counters and events are
not frames.
"""

from __future__ import annotations

import re

import can

from yieldmon import utc

from .fields import Form, data_bytes, error_frame, fd_length, message, seconds, whole

_COLUMNS = {"1.0": "NOIlD", "1.1": "NOTIlD", "1.2": "NOBTIlD", "1.3": "NOBTIRlD"}
_SETTING = re.compile(r";\$(FILEVERSION|STARTTIME|COLUMNS)=(\S+)")
_DATA_TYPES = {
    "DT": (False, False, False),
    "FD": (True, False, False),
    "FB": (True, True, False),
    "FE": (True, False, True),
    "BI": (True, True, True),
}
"""CAN FD, with bit rate switch, with error state."""
_NO_FRAMES = frozenset({"ST", "EC", "EV", "Warng"})
_NO_IDENTIFIER = "FFFFFFFF"
_CHANNEL = 1
"""Of versions that name none."""


class Trace:
    """Reads line by line, as the lines with `;$` say."""

    def __init__(self) -> None:
        self._version = "1.0"
        self._columns = _COLUMNS[self._version]
        self._start_s = 0.0

    def __call__(self, line: str) -> can.Message | None:
        """As fields.Parser."""
        line = line.strip()
        if line.startswith(";") or not line:
            self._setting(line)
            return None
        if problem := self.incomplete:
            raise ValueError(problem)
        fields = line.split(maxsplit=len(self._columns) - 1)
        of = dict(zip(self._columns, fields, strict=False))
        if "O" not in of or ("T" in self._columns and "T" not in of):
            raise ValueError(f"{line[:40]!r} is not a line of a trace of version {self._version}")
        return self._frame(of, self._start_s)

    @property
    def incomplete(self) -> str | None:
        """Why lines of frames cannot be read yet."""
        if self._columns:
            return None
        if self._version.startswith("2."):
            return f"a trace of version {self._version} that does not name its columns (;$COLUMNS=)"
        return f"a trace of version {self._version}; expected 1.0 to 2.1"

    def _setting(self, line: str) -> None:
        found = _SETTING.match(line)
        if found is None:
            return
        value = found[2].rstrip(";")
        if found[1] == "FILEVERSION":
            self._version, self._columns = value, _COLUMNS.get(value, "")
        elif found[1] == "COLUMNS":
            self._columns = value.replace(",", "")
            if not set("NOTId") <= set(self._columns) or not set("lL") & set(self._columns):
                raise ValueError(f"columns {value[:40]}; expected N, O, T, I, d, l or L, D")
        else:
            start_s = utc.of_serial_days(seconds(value, "start time"))
            try:
                utc.moment(start_s)
            except (OverflowError, ValueError, OSError):
                raise ValueError(f"start time {value[:20]} is not a date") from None
            self._start_s = start_s

    def _frame(self, of: dict[str, str], start_s: float) -> can.Message | None:
        kind, data = of.get("T", "Rx"), of.get("D", "")
        if kind in _NO_FRAMES or (kind == "Rx" and of.get("I") == _NO_IDENTIFIER):
            return None
        time_s = seconds(of["O"]) / 1000 + start_s
        channel = whole(of["B"], "bus") if of.get("B", "-") != "-" else _CHANNEL
        if kind in ("ER", "Error") or data.startswith("ERROR"):
            return error_frame(time_s, channel)
        if not of.keys() >= {"I"} or not ({"l", "L"} & of.keys()):
            raise ValueError("ends before its length")
        if kind not in ((*_DATA_TYPES, "RR") if "d" in of else ("Rx", "Tx")):
            raise ValueError(f"type {kind[:20]!r} is not known")
        is_fd, bit_rate_switch, error_state = _DATA_TYPES.get(kind, (False, False, False))
        length = whole(of["l"], "length") if "l" in of else whole(of["L"], "length")
        is_remote = kind == "RR" or data.strip() == "RTR"
        form = Form(
            whole(of["I"], "identifier", 16),
            len(of["I"]) > 4,
            is_rx=of.get("d", kind) == "Rx",
            is_remote=is_remote,
            is_fd=is_fd,
            bit_rate_switch=bit_rate_switch,
            error_state=error_state,
        )
        content = b"" if is_remote else data_bytes(data.split())
        if is_fd and "L" in of and length != len(content):
            # PEAK's programs write the code here, others the length.
            length = fd_length(length)
        return message(time_s, channel, form, content, length)
