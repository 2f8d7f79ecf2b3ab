"""Columns and fields of a logger's text lines as numbers; ValueError, which names the field, where one is not a number."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from datetime import UTC, datetime
from typing import NamedTuple

import can

from yieldmon.identifiers import FD_LENGTHS, LARGEST_STANDARD_ID

#: Takes a line of one log without its line end; returns its frame, or None for a line without one. Raises ValueError, which says
#: why the line cannot be read.
Parser = Callable[[str], can.Message | None]
_LARGEST = 2**60
"""Largest number that a field may hold; microseconds since 1970 need 51 bits."""


class Form(NamedTuple):
    """What an identifier and its flags say of a frame, without its data."""

    arbitration_id: int
    is_extended: bool
    is_rx: bool = True
    is_remote: bool = False
    is_fd: bool = False
    bit_rate_switch: bool = False
    error_state: bool = False


def require_columns(columns: Collection[str], needed: Iterable[str], example: str = "") -> None:
    """Raises ValueError for a heading without a needed column; example: of such a heading."""
    for name in needed:
        if name not in columns:
            raise ValueError(f"lacks the column {name}" + (f"; expected columns such as {example}" if example else ""))


def require_as_many(fields: Sequence[str], columns: int) -> None:
    """Raises ValueError for a line that has not one field for each column of the heading."""
    if len(fields) != columns:
        raise ValueError(f"{len(fields)} fields; expected {columns}, as in the heading")


def whole(text: str, what: str, base: int = 10) -> int:
    """A whole number that is not negative; `base` 16 with or without 0x. Raises ValueError."""
    try:
        number = int(text, base)
    except ValueError:
        number = -1
    if not 0 <= number <= _LARGEST:
        raise ValueError(f"{what} {text[:20]!r} is not a {'hexadecimal ' if base == 16 else ''}number")
    return number


def seconds(text: str, what: str = "time") -> float:
    """A number with a point or a comma. Raises ValueError."""
    try:
        number = float(text.replace(",", "."))
    except ValueError:
        number = math.nan
    if not abs(number) <= _LARGEST:
        raise ValueError(f"{what} {text[:20]!r} is not a number")
    return number


def switch(text: str, what: str) -> bool:
    """0 or 1, true or false. Raises ValueError."""
    known = {"0": False, "false": False, "1": True, "true": True}
    if text.lower() not in known:
        raise ValueError(f"{what} {text[:20]!r} is not 0 or 1, true or false")
    return known[text.lower()]


def data_bytes(fields: Sequence[str], base: int = 16) -> bytes:
    """One byte a field. Raises ValueError."""
    numbers = [whole(text, "byte", base) for text in fields]
    if any(number > 0xFF for number in numbers):
        raise ValueError(f"byte {max(numbers)} is above 255")
    return bytes(numbers)


def hex_bytes(text: str) -> bytes:
    """Two hexadecimal digits a byte, in one field. Raises ValueError."""
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise ValueError(f"data {text[:20]!r} are not hexadecimal bytes") from None


def fd_length(code: int) -> int:
    """Bytes of a CAN FD frame by its data length code. Raises ValueError for a code above 15."""
    if code >= len(FD_LENGTHS):
        raise ValueError(f"data length code {code} is above 15")
    return FD_LENGTHS[code]


def clock_s(year: int, month: int, day: int, hour: int, minute: int, second: int) -> float:
    """Unix time of a clock's reading, taken as UTC: logs do not name their time zone."""
    return datetime(year, month, day, hour, minute, second, tzinfo=UTC).timestamp()


def message(time_s: float, channel: int | str | None, form: Form, data: bytes, length: int) -> can.Message:
    """A frame. Raises ValueError where the number of data bytes differs from its length; a remote frame has no data."""
    if not form.is_remote and len(data) != length:
        raise ValueError(f"{len(data)} bytes of data where the length says {length}")
    return can.Message(
        timestamp=time_s,
        channel=channel,
        arbitration_id=form.arbitration_id,
        is_extended_id=form.is_extended,
        is_remote_frame=form.is_remote,
        is_rx=form.is_rx,
        is_fd=form.is_fd,
        bitrate_switch=form.bit_rate_switch,
        error_state_indicator=form.error_state,
        dlc=length,
        data=None if form.is_remote else data,
    )


def error_frame(time_s: float, channel: int | str | None) -> can.Message:
    """An error frame of whatever kind."""
    return can.Message(timestamp=time_s, channel=channel, is_error_frame=True, is_extended_id=False, dlc=0)


def extended(arbitration_id: int, *, marked: bool) -> bool:
    """Whether an identifier has 29 bits: as marked, or since it is too large for 11."""
    return marked or arbitration_id > LARGEST_STANDARD_ID
