"""CSV of SavvyCAN and GVRET: microseconds, hexadecimal identifiers, one column a byte.

Two forms, with and without the direction::

    Time Stamp,ID,Extended,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    166064000,0000021A,false,0,8,FE,36,12,FE,69,05,07,AD,
    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    39747828,000005EB,false,Rx,0,8,E8,45,85,4B,4A,28,36,69,

Times count from the recorder's start, or from 1970, as it has them. It writes eight bytes of a CAN FD frame, however long it was.
Remote and error frames have no mark.
"""

from __future__ import annotations

import can

from .fields import Form, Parser, data_bytes, extended, message, switch, whole

_HEADING = ("time stamp", "id", "extended", "bus", "len")


def parser(heading: str) -> Parser | None:
    """The reader of the lines after this one; None where it is not SavvyCAN's heading.

    The reader raises ValueError for a line with too few fields.
    """
    columns = [column.strip().lower() for column in heading.split(",")]
    if not set(_HEADING) <= set(columns) or columns[0] != _HEADING[0]:
        return None
    place = {name: index for index, name in enumerate(columns)}
    time_at, id_at, extended_at, bus_at, length_at = (place[name] for name in _HEADING)
    direction_at, first_byte = place.get("dir"), length_at + 1

    def frame(line: str) -> can.Message | None:
        fields = [field.strip() for field in line.split(",")]
        if fields == [""]:
            return None
        if len(fields) <= length_at:
            raise ValueError(f"{len(fields)} fields; expected {length_at + 1} and the bytes")
        text = fields[time_at]
        microseconds = -whole(text[1:], "time") if text.startswith("-") else whole(text, "time")
        arbitration_id, length = whole(fields[id_at], "identifier", 16), whole(fields[length_at], "length")
        form = Form(
            arbitration_id,
            extended(arbitration_id, marked=switch(fields[extended_at], "extended")),
            is_rx=direction_at is None or fields[direction_at].lower() != "tx",
        )
        data = data_bytes([field for field in fields[first_byte : first_byte + length] if field])
        return message(microseconds / 1e6, whole(fields[bus_at], "bus"), form, data, length)

    return frame
