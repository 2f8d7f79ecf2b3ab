"""A signal's value out of a frame's bytes: one frame at a time, and columns of millions, with the same result."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.databases import SignalBits
from yieldmon.physics.numerics import Array

_FLOATS = {16: ("<e", np.uint16, np.float16), 32: ("<f", np.uint32, np.float32), 64: ("<d", np.uint64, np.float64)}


@dataclass(frozen=True, slots=True)
class Extraction:
    """value = raw * scale + offset, nan for raw values that are no measurement and for values outside low .. high.

    codes: raw value -> value in place of that; not in it: nan. None: as above.
    """

    bits: SignalBits
    scale: float
    offset: float
    low: float = float("-inf")
    high: float = float("inf")
    not_available: frozenset[int] = frozenset()
    codes: tuple[tuple[int, float], ...] | None = None

    def raw(self, little: int, big: int) -> int:
        """Raw value, unsigned or signed; a float's pattern of bits. little, big: the frame's eight bytes as a number."""
        bits = self.bits
        raw = (little if bits.little else big) >> bits.shift & (1 << bits.bits) - 1
        return raw - (1 << bits.bits) if bits.kind == "int" and raw >> bits.bits - 1 else raw

    def value(self, little: int, big: int) -> float:
        """Value of one frame."""
        raw = self.raw(little, big)
        if raw in self.not_available or (self.bits.raw_max is not None and raw > self.bits.raw_max):
            return float("nan")
        if self.codes is not None:
            return next((value for code, value in self.codes if code == raw), float("nan"))
        number = float(raw)
        if self.bits.kind == "float":
            (number,) = struct.unpack(_FLOATS[self.bits.bits][0], raw.to_bytes(self.bits.bits // 8, "little"))
        value = number * self.scale + self.offset
        return value if self.low <= value <= self.high else float("nan")

    def raws(self, little: NDArray[np.uint64], big: NDArray[np.uint64]) -> NDArray[np.int64]:
        """Raw values of many frames (n,); 64-bit unsigned ones above 2**63 wrap."""
        bits = self.bits
        mask = np.uint64((1 << bits.bits) - 1)
        raw: NDArray[np.int64] = ((little if bits.little else big) >> np.uint64(bits.shift) & mask).astype(np.int64)
        if bits.kind == "int":
            spare = np.int64(64 - bits.bits)
            raw = (raw << spare) >> spare
        return raw

    def values(self, little: NDArray[np.uint64], big: NDArray[np.uint64]) -> Array:
        """Values of many frames (n,)."""
        raw = self.raws(little, big)
        usable = np.ones(raw.shape, dtype=bool)
        if self.bits.raw_max is not None:
            usable &= raw <= self.bits.raw_max
        if self.not_available:
            usable &= ~np.isin(raw, np.array(sorted(self.not_available)))
        if self.codes is not None:
            found = np.full(raw.shape, np.nan)
            for code, value in self.codes:
                found[raw == code] = value
            return np.where(usable, found, np.nan)
        if self.bits.kind == "float":
            _, unsigned, kind = _FLOATS[self.bits.bits]
            numbers: Array = raw.astype(unsigned).view(kind).astype(np.float64)
        else:
            numbers = raw.astype(np.float64)
        with np.errstate(invalid="ignore", over="ignore"):
            found = numbers * self.scale + self.offset
            return np.where(usable & (found >= self.low) & (found <= self.high), found, np.nan)
