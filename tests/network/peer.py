"""What another node of the bus makes of our trouble codes, and the fast packets that it sends."""

from __future__ import annotations

from collections.abc import Iterator

from yieldmon.network.diagnostics import TroubleCode
from yieldmon.network.fast_packet import MAX_BYTES
from yieldmon.network.identifier import RawFrame, frame

_CODE_BYTES = 4
_FIRST_PART_BYTES, _PART_BYTES = 6, 7


def read(data: bytes) -> tuple[TroubleCode, ...]:
    """The codes in a DM1 or DM2 of any node; lamps are those of the whole message and are left out."""
    codes = []
    for at in range(2, len(data) - _CODE_BYTES + 1, _CODE_BYTES):
        low, middle, high, count = data[at : at + _CODE_BYTES]
        spn, fmi = low | middle << 8 | (high >> 5) << 16, high & 0x1F
        if spn in (0, 0x7FFFF):
            continue
        codes.append(TroubleCode(spn, fmi, occurrences=count & 0x7F))
    return tuple(codes)


def split(group: int, data: bytes, source: int, *, counter: int, priority: int = 6) -> Iterator[RawFrame]:
    """The frames of a fast packet. counter: 0 to 7, another one for each packet of a group."""
    if not 0 < len(data) <= MAX_BYTES:
        raise ValueError(f"fast packet of {len(data)} bytes, expected 1 to {MAX_BYTES}")
    lead = (counter & 7) << 5
    first = bytes([lead, len(data)]) + data[:_FIRST_PART_BYTES].ljust(_FIRST_PART_BYTES, b"\xff")
    yield frame(group, first, source, priority=priority)
    for number, at in enumerate(range(_FIRST_PART_BYTES, len(data), _PART_BYTES), start=1):
        part = data[at : at + _PART_BYTES].ljust(_PART_BYTES, b"\xff")
        yield frame(group, bytes([lead | number]) + part, source, priority=priority)
