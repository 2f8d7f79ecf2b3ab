"""CAN frames as Parquet: columns by message, coded exactly, compressed with zstd (the parquet extra).

The file is a table of columns. Each row holds one column of one message (channel, identifier, length) over one block of
frames: `block`, `channel`, `can_id` (with the flags of linux/can.h), `length`, `frames`, `column` (a signal's name where
the DBC has the message, otherwise a stretch of bits of the data; `time` and, where arrival order is not that of time,
`place`), `start`, `bits`, `coding`, `width`, `size` (of the data before compression), `data`. Reading gives the frames
that were packed, to the last bit and in their order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

FORMAT = b"yieldmon.frames"
DROPPED = b"yieldmon.dropped_by_recorder"
"""How many frames the recorders of the logs say that they lost; absent for none."""
BEGINS = b"yieldmon.logs_begin"
"""Numbers of the blocks with which the second and further logs of the record begin, as "3,7"; absent where there is one log."""
VERSION = b"2"
ALL_COMPRESSED = b"1"
"""The format before, in which no column was kept as it is."""
TIME, PLACE = "time", "place"
PER_S = {"us": 1e6, "ns": 1e9}
"""Units of whole-number times, by how many there are in a second."""
FLOAT = "float64"
DATA_BITS = 64
NAMES = ("block", "channel", "can_id", "length", "frames", "column", "start", "bits", "coding", "width", "size", "data")


def schema() -> pa.Schema:
    """Columns of the file and their types."""
    import pyarrow as pa

    kinds = (
        *(pa.int32(), pa.string(), pa.uint32(), pa.uint8(), pa.int32(), pa.string(), pa.string()),
        *(pa.uint8(), pa.string(), pa.uint8(), pa.int32(), pa.binary()),
    )
    return pa.schema(list(zip(NAMES, kinds, strict=True)))
