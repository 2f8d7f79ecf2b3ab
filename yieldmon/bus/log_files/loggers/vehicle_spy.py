"""CSV of Intrepid's Vehicle Spy ("Vehicle Spy 3 Bus Traffic File").

Below a header come one or more headings, the one of CAN frames among them, and the frames::

    Line,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node,Arb ID,Remote,Xtd,B1,B2,B3,B4,B5,B6,B7,B8,Value
    2,2550.368293675,0.003818174999651092,67371008,F,F,HS CAN $119,HS CAN,,119,F,F,00,00,00,00,00,00,0D,8B,

Identifiers and bytes are hexadecimal, flags T or F. Times count from the start of the measurement: the dates of the header are
written as the computer's country does and not used. A row of another network than CAN, or of CAN FD, is reported.
"""

from __future__ import annotations

import re

import can

from .fields import Form, Parser, data_bytes, error_frame, extended, message, seconds, whole

_FIRST_LINE, _HEADING = "Vehicle Spy", "Line,Abs Time"
_TIME, _NETWORK, _ID, _EXTENDED, _ERROR, _SENT = "Abs Time(Sec)", "Network", "Arb ID", "Xtd", "Er", "Tx"
_NEEDED = (_TIME, _NETWORK, _ID, _EXTENDED, _ERROR, _SENT)
_REMOTE = re.compile(r"Remote\b.*")
_FLAGS = {"F": False, "T": True}


def parser(first_line: str) -> Parser | None:
    """The reader of the lines after this one; None where no Vehicle Spy file begins so."""
    plain = first_line.replace('"', "")
    if not plain.startswith((_FIRST_LINE, _HEADING)):
        return None
    read = _VehicleSpy()
    read(plain)
    return read


class _VehicleSpy:
    def __init__(self) -> None:
        self._place: dict[str, int] = {}
        self._remote_at = 0
        self._data_at: list[int] = []

    def __call__(self, line: str) -> can.Message | None:
        """As fields.Parser."""
        fields = [field.strip().strip('"') for field in line.split(",")]
        if fields[0] == "Line":
            self._heading(fields)
            return None
        if not fields[0].isdigit():
            return None
        if not self._place:
            raise ValueError("no heading above names the columns of CAN frames (Line,Abs Time(Sec),...,Arb ID,Remote,Xtd,B1,...)")
        return self._frame(fields)

    def _heading(self, columns: list[str]) -> None:
        remote = [place for place, name in enumerate(columns) if _REMOTE.fullmatch(name)]
        if remote and set(_NEEDED) <= set(columns):
            self._place = {name: columns.index(name) for name in _NEEDED}
            self._remote_at = remote[0]
            self._data_at = [place for place, name in enumerate(columns) if re.fullmatch(r"B\d", name)]

    def _frame(self, fields: list[str]) -> can.Message:
        if len(fields) <= max(self._data_at, default=0):
            raise ValueError(f"{len(fields)} fields; expected more, as in the heading")
        text = {name: fields[place] for name, place in self._place.items()}
        flags = [fields[self._remote_at], *(text[name] for name in (_EXTENDED, _ERROR, _SENT))]
        if not set(flags) <= _FLAGS.keys():
            raise ValueError(f"{','.join(fields)[:60]!r} is not a classic CAN frame: Remote, Xtd, Er and Tx are not T or F")
        is_remote, is_marked, is_error, is_sent = (_FLAGS[flag] for flag in flags)
        time_s = seconds(text[_TIME])
        if is_error:
            return error_frame(time_s, text[_NETWORK])
        arbitration_id = whole(text[_ID], "identifier", 16)
        cells = [fields[place] for place in self._data_at]
        data = data_bytes(cells[: cells.index("")] if "" in cells else cells)
        form = Form(arbitration_id, extended(arbitration_id, marked=is_marked), is_rx=not is_sent, is_remote=is_remote)
        return message(time_s, text[_NETWORK], form, b"" if is_remote else data, len(data))
