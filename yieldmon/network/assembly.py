"""Putting a message together from numbered parts of seven bytes, in whatever order and number they come."""

from __future__ import annotations

PART_BYTES = 7
#: Most that the transport protocol carries: 255 parts.
MAX_BYTES = 1785


def parts_in(size: int) -> int:
    """Parts that a message of `size` bytes takes."""
    return -(-size // PART_BYTES)


class Assembly:
    """One message in the making.

    Parameters
    ----------
    size : int
        Bytes of the whole message, 9 to 1785.
    """

    __slots__ = ("_data", "_missing", "parts", "size")

    def __init__(self, size: int) -> None:
        if not 8 < size <= MAX_BYTES:
            raise ValueError(f"message of {size} bytes, expected 9 to {MAX_BYTES}")
        self.size = size
        self.parts = parts_in(size)
        self._data = bytearray(self.parts * PART_BYTES)
        self._missing = set(range(1, self.parts + 1))

    def put(self, number: int, part: bytes) -> bool:
        """Takes part `number`, 1 the first; False for one that is not wanted (any more)."""
        if number not in self._missing or len(part) != PART_BYTES:
            return False
        self._missing.discard(number)
        at = (number - 1) * PART_BYTES
        self._data[at : at + PART_BYTES] = part
        return True

    @property
    def first_missing(self) -> int | None:
        """Number of the first part that has not come; None when all have."""
        return min(self._missing, default=None)

    @property
    def data(self) -> bytes:
        """The message, once nothing is missing."""
        return bytes(self._data[: self.size])
