"""CSV that CSS Electronics' converters make of CANedge's MF4 files: seconds since 1970, hexadecimal identifiers.

Lines, with the delimiter that the converter was given, and ESI and RTR in newer ones::

    TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes
    1581670628.161750;1;123;0;1;1;0;0;0;12
    TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;ESI;RTR;DataBytes

Dir is 0 for received. Without the column RTR a remote frame is one with a length and no data. CANedge keeps error frames apart.
"""

from __future__ import annotations

import can

from .fields import Form, Parser, hex_bytes, message, require_as_many, require_columns, seconds, switch, whole

_NEEDED = ("TimestampEpoch", "BusChannel", "ID", "IDE", "DataLength", "DataBytes")
_OPTIONAL = ("Dir", "EDL", "BRS", "ESI", "RTR")


def parser(heading: str) -> Parser | None:
    """The reader of the lines after this one; None where it is not CANedge's heading. Raises ValueError for one
    that lacks a column."""
    if not heading.startswith(_NEEDED[0]):
        return None
    delimiter = heading[len(_NEEDED[0]) : len(_NEEDED[0]) + 1]
    columns = [column.strip() for column in heading.split(delimiter)] if delimiter else []
    require_columns(columns, _NEEDED)
    place = {name: columns.index(name) for name in (*_NEEDED, *_OPTIONAL) if name in columns}

    def frame(line: str) -> can.Message | None:
        fields = [field.strip() for field in line.split(delimiter)]
        if fields == [""]:
            return None
        require_as_many(fields, len(columns))
        flags = {name: switch(fields[place[name]] or "0", name) for name in _OPTIONAL if name in place}
        length, text = whole(fields[place["DataLength"]], "length"), fields[place["DataBytes"]]
        form = Form(
            whole(fields[place["ID"]], "identifier", 16),
            switch(fields[place["IDE"]], "IDE"),
            is_rx=not flags.get("Dir", False),
            is_remote=flags.get("RTR", length > 0 and not text),
            is_fd=flags.get("EDL", False),
            bit_rate_switch=flags.get("BRS", False),
            error_state=flags.get("ESI", False),
        )
        return message(
            seconds(fields[place["TimestampEpoch"]]), whole(fields[place["BusChannel"]], "channel"), form, hex_bytes(text), length
        )

    return frame
