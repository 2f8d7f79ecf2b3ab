"""A signal's value out of a frame's bytes: one frame at a time, and columns of millions, with the same result."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.databases import SignalBits
from yieldmon.physics.numerics import Array

_FLOATS = {16: ("<e", np.uint16, np.float16), 32: ("<f", np.uint32, np.float32), 64: ("<d", np.uint64, np.float64)}


_WIDEST = 64
_NO_VALUE = re.compile(r"not.?av|unavail|\bn/?a\b|\bsna\b|error|invalid|fault|nicht.?verf|fehler|ung(?:ue|.)ltig", re.IGNORECASE)
"""In names that a DBC's value table gives to raw values that are none."""
_A_VALUE = re.compile(
    r"(?:no|not|without|ohne|keine?)[ _-]?(?:error|invalid|fault|fehler)|default|(?:error|fault|fehler)[ _-]?fr(?:ee|ei)",
    re.IGNORECASE,
)
"""In names where such words say the opposite, or are part of another."""


def named_no_value(bits: SignalBits) -> frozenset[int]:
    """Raw values of a measurement that the DBC's value table calls none, beside those that J1939 keeps."""
    named = {raw for name, raw in bits.choices.items() if _NO_VALUE.search(_A_VALUE.sub("", name))}
    if bits.kind == "int":
        # Tables have them as numbers or as patterns of bits.
        named = {raw - (1 << bits.bits) if raw >> bits.bits - 1 == 1 else raw for raw in named}
    return frozenset(raw for raw in named if bits.raw_max is None or raw <= bits.raw_max)


@dataclass(frozen=True, slots=True)
class Extraction:
    """value = raw * scale + offset, nan for raw values that are no measurement and for values outside low .. high.

    codes: raw value -> value in place of that; not in it: nan. None: as above. over: of a signal that is a period, whose value is
    this over raw * scale + offset; 0 of any other.
    """

    bits: SignalBits
    scale: float
    offset: float
    low: float = float("-inf")
    high: float = float("inf")
    not_available: frozenset[int] = frozenset()
    codes: tuple[tuple[int, float], ...] | None = None
    over: float = 0.0

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
        if self.over:
            value = self.over / value if value else float("nan")
        return value if self.low <= value <= self.high else float("nan")

    def raws(self, little: NDArray[np.uint64], big: NDArray[np.uint64]) -> NDArray[np.int64] | NDArray[np.uint64]:
        """Raw values of many frames (n,); uint64 where all 64 bits are one without a sign."""
        bits = self.bits
        raw: NDArray[np.uint64] = (little if bits.little else big) >> np.uint64(bits.shift) & np.uint64((1 << bits.bits) - 1)
        if bits.bits == _WIDEST and bits.kind != "int":
            return raw
        signed = raw.astype(np.int64)
        if bits.kind == "int":
            spare = np.int64(_WIDEST - bits.bits)
            signed = (signed << spare) >> spare
        return signed

    def values(self, little: NDArray[np.uint64], big: NDArray[np.uint64]) -> Array:
        """Values of many frames (n,)."""
        return self.of_raws(self.raws(little, big))

    def of_raws(self, raw: NDArray[np.int64] | NDArray[np.uint64]) -> Array:
        """Values of raw values (n,), as `raws` has them."""
        usable = np.ones(raw.shape, dtype=bool)
        if self.bits.raw_max is not None:
            usable &= raw <= self.bits.raw_max
        if self.not_available:
            usable &= ~np.isin(raw, np.array(sorted(self.not_available), raw.dtype))
        if self.codes is not None:
            found = np.full(raw.shape, np.nan)
            for code, value in self.codes:
                found[raw == code] = value
            return np.where(usable, found, np.nan)
        if self.bits.kind == "float":
            _, unsigned, kind = _FLOATS[self.bits.bits]
            with np.errstate(invalid="ignore"):
                numbers: Array = raw.astype(unsigned).view(kind).astype(np.float64)
        else:
            numbers = raw.astype(np.float64)
        with np.errstate(invalid="ignore", over="ignore"):
            found = numbers * self.scale + self.offset
            if self.over:
                found = np.divide(self.over, found, out=np.full(found.shape, np.nan), where=found != 0.0)
            return np.where(usable & (found >= self.low) & (found <= self.high), found, np.nan)
