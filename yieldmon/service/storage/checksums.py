"""The checksum that a row of the store carries: of its table's name and its values as SQLite gives them back."""

from __future__ import annotations

import zlib
from math import isnan

Value = int | float | str | bytes | None

#: What a row has that was written before rows carried checksums.
UNCHECKED = -1


def row_checksum(table: str, *values: Value) -> int:
    """CRC-32 of a row, from 0 to 2**32 - 1.

    Parameters
    ----------
    table
        Name of the table, so that a row that turns up in another one does not pass.
    values
        The row's values in the order of its columns, the checksum left out. Equal numbers give equal sums, whatever their kind:
        a column of reals stores the whole number 30 as 30.0 and -0.0 as 0.0, and a NaN becomes NULL.
    """
    text = "\x1f".join((table, *map(_canonical, values)))
    return zlib.crc32(text.encode("utf-8", "surrogateescape"))


def _canonical(value: Value) -> str:
    if value is None:
        return "n"
    if isinstance(value, str):
        return f"t{value}"
    if isinstance(value, bytes):
        return f"b{value.hex()}"
    if isinstance(value, int) and abs(value) > 2**53:
        return f"i{value}"
    return "n" if isnan(value) else f"r{float(value) + 0.0!r}"
