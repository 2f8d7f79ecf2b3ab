"""A quantity's value into the bits of a signal, and signals into a frame's bytes: the way back of `extraction`."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from yieldmon.bus.databases import SignalBits

_FLOATS = {16: "<e", 32: "<f", 64: "<d"}
_LARGEST_FLOAT = {16: 65504.0, 32: 3.4028234663852886e38, 64: 1.7976931348623157e308}


@dataclass(frozen=True, slots=True)
class Packing:
    """raw = (value - offset) / scale, to the nearest whole number.

    low, high: smallest and largest value that is sent. codes: value -> raw value in place of that. not_available: raw value for a
    value that is not known or not in that range; None: the signal has none. counts: whole numbers that begin again at 0.
    """

    bits: SignalBits
    scale: float
    offset: float
    low: float
    high: float
    not_available: int | None = None
    codes: tuple[tuple[int, int], ...] | None = None
    counts: bool = False

    def raw(self, value: float | None) -> int | None:
        """The signal's bits for a value (None: not known); None where the signal cannot say it."""
        if value is None or not math.isfinite(value):
            return self.not_available
        if self.counts:
            return int(value) % min(largest_raw(self.bits) + 1, self.bits.turns_at)
        if self.codes is not None:
            return dict(self.codes).get(int(value), self.not_available)
        if not self.low <= value <= self.high:
            return self.not_available
        found = encoded(self.bits, (value - self.offset) / self.scale)
        return self.not_available if found is None else found


def largest_raw(bits: SignalBits) -> int:
    """Largest raw value that is a value."""
    if bits.raw_max is not None:
        return bits.raw_max
    return (1 << bits.bits - (bits.kind == "int")) - 1


def span(bits: SignalBits) -> tuple[float, float]:
    """Smallest and largest raw value of a signal."""
    if bits.kind == "float":
        return -_LARGEST_FLOAT[bits.bits], _LARGEST_FLOAT[bits.bits]
    return (-float(1 << bits.bits - 1) if bits.kind == "int" else 0.0), float(largest_raw(bits))


def encoded(bits: SignalBits, number: float) -> int | None:
    """The bits of a raw number, which is rounded for whole ones; None where it does not fit."""
    low, high = span(bits)
    if bits.kind == "float":
        return int.from_bytes(struct.pack(_FLOATS[bits.bits], number), "little") if low <= number <= high else None
    whole = round(number)
    return whole & (1 << bits.bits) - 1 if low <= whole <= high else None


def packed(length: int, ones: bool, signals: Iterable[tuple[SignalBits, int]]) -> bytes:
    """The data of a frame of so many bytes; bits that no signal uses are 1 or 0."""
    data = (b"\xff" if ones else b"\x00") * 8
    for bits, raw in signals:
        order: Literal["little", "big"] = "little" if bits.little else "big"
        mask = (1 << bits.bits) - 1 << bits.shift
        number = int.from_bytes(data, order) & ~mask | raw << bits.shift
        data = number.to_bytes(8, order)
    return data[:length]
