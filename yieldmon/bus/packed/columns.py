"""Columns of whole numbers as few bytes, exactly: what packed frames consist of.

A column is an array of unsigned 64-bit numbers below 2**bits. Each coding gives bytes that a general compressor (zstd)
packs well: differences, or the errors of a linear prediction for sampled signals (as in lossless audio coding, e.g.
Robinson 1994, "Shorten"), split into planes of equal significance.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.interrupts import interrupts_held

Column = NDArray[np.uint64]

CONSTANT = "constant"
PLAIN = "plain"
DIFFERENCE = "difference"
PREDICTION = "prediction"

ORDER = 8
"""Samples that predict the next; known to a compiler, so that the sum over them is no loop."""
#: Samples in a row that are predicted from each other. All stretches are decoded side by side: each step of the prediction is
#: one operation over them.
_STRETCH = 1024
_COEFFICIENT_SCALE = float(1 << 14)
_HEADER = np.dtype("<i8")
_WORD = 64
#: Sums of a prediction stay whole numbers that a double holds.
_MOST_BITS = 32


class Coded(NamedTuple):
    """A column's coding, width of a residual in bytes, and bytes."""

    coding: str
    width: int
    data: bytes


def encode(values: Column, bits: int, *, sampled: bool = False) -> Coded:
    """Code a column in the way that seems to take least.

    Parameters
    ----------
    values : uint64 array, shape (n,)
        Numbers below 2**bits.
    bits : int
        1 to 64.
    sampled : bool
        Successive values are samples of one signal.

    Returns
    -------
    Coded
    """
    if values.size and (values == values[0]).all():
        return Coded(CONSTANT, 8, int(values[0]).to_bytes(8, "little"))
    found = [_planes(PLAIN, values), _planes(DIFFERENCE, _folded(np.diff(values, prepend=np.uint64(0)), bits))]
    if sampled and bits <= _MOST_BITS and values.size >= 4 * _STRETCH:
        found.append(_predicted(values, bits))
    return min(found, key=_entropy_bytes)


def decode(coded: Coded, count: int, bits: int, *, compiled: bool = False) -> Column:
    """The column again.

    Parameters
    ----------
    coded : Coded
    count : int
        Length of the column.
    bits : int
        As for `encode`.
    compiled : bool
        With the fast extra's compiled code where it is installed; the same numbers.

    Returns
    -------
    uint64 array, shape (count,)

    Raises
    ------
    ValueError
        The bytes are not those of such a column.
    """
    if coded.coding == CONSTANT:
        return np.full(count, int.from_bytes(coded.data, "little"), np.uint64)
    if not 1 <= coded.width <= _WORD // 8:
        raise ValueError(f"numbers of {coded.width} bytes; expected 1 to {_WORD // 8}")
    if coded.coding == PLAIN:
        return _from_planes(coded.data, coded.width, count)
    if coded.coding == DIFFERENCE:
        return _from_differences(coded, count, bits, compiled=compiled)
    if coded.coding == PREDICTION:
        return _from_predicted(coded, count, bits, compiled=compiled)
    raise ValueError(f"unknown coding {coded.coding!r}")


def place_fields(payload: Column, column: Column, starts: Sequence[int], *, compiled: bool = False) -> None:
    """Put a column's numbers into frames' data.

    Parameters
    ----------
    payload : uint64 array, shape (n,)
        Data of the frames; 0 where the numbers go.
    column : uint64 array, shape (n * len(starts),)
        Numbers, those of a frame beside each other.
    starts : sequence of int
        First bit of each of a frame's numbers.
    compiled : bool
        As for `decode`.
    """
    module = _compiled_module() if compiled and len(starts) > 1 else None
    if module is not None:
        module.place_fields(payload, column, np.array(starts, np.uint64))
        return
    for place, start in enumerate(starts):
        payload |= column[place :: len(starts)] << np.uint64(start)


def _mask(bits: int) -> np.uint64:
    return np.uint64((1 << bits) - 1)


def _folded(differences: Column, bits: int) -> Column:
    """Differences modulo 2**bits with small ones of both signs near 0: 0, -1, 1, -2, ..."""
    spare = np.uint64(_WORD - bits)
    signed = ((differences & _mask(bits)) << spare).view(np.int64) >> np.int64(_WORD - bits)
    return ((signed << np.int64(1)) ^ (signed >> np.int64(_WORD - 1))).view(np.uint64)


def _unfolded(folded: Column, bits: int) -> Column:
    sign = np.uint64(0) - (folded & np.uint64(1))
    return ((folded >> np.uint64(1)) ^ sign) & _mask(bits)


def _planes(coding: str, values: Column, header: bytes = b"") -> Coded:
    largest = int(values.max(initial=0))
    width = max(1, -(-largest.bit_length() // 8))
    planes = values.astype("<u8").view(np.uint8).reshape(-1, 8)[:, :width]
    return Coded(coding, width, header + np.ascontiguousarray(planes.T).tobytes())


def _planes_in(data: bytes, width: int, count: int) -> NDArray[np.uint8]:
    """(width, count)"""
    if len(data) != width * count:
        raise ValueError(f"{len(data)} bytes; expected {width * count}")
    return np.frombuffer(data, np.uint8).reshape(width, count)


def _from_planes(data: bytes, width: int, count: int) -> Column:
    planes = _planes_in(data, width, count)
    values: Column = planes[0].astype(np.uint64)
    for place in range(1, width):
        values |= planes[place].astype(np.uint64) << np.uint64(8 * place)
    return values


def _entropy_bytes(coded: Coded) -> float:
    """Size to expect of a column once its planes are compressed byte by byte."""
    planes = np.frombuffer(coded.data, np.uint8)
    size = planes.size // coded.width
    total = 0.0
    for plane in range(coded.width):
        counts = np.bincount(planes[plane * size : (plane + 1) * size])
        shares = counts[counts > 0] / max(1, size)
        total -= size * float((shares * np.log2(shares)).sum()) / 8.0
    return total


def _stretches(count: int) -> int:
    """Number of stretches; the last one is filled up."""
    return -(-count // _STRETCH)


def _matrix(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Stretches as columns, time down the rows."""
    filled = np.full(_stretches(values.size) * _STRETCH, values[-1])
    filled[: values.size] = values
    return np.ascontiguousarray(filled.reshape(-1, _STRETCH).T)


def _predicted(values: Column, bits: int) -> Coded:
    samples = _matrix(values.view(np.int64))
    past = np.lib.stride_tricks.sliding_window_view(samples.astype(np.float64), ORDER, axis=0)[:-1]
    flat = past.reshape(-1, ORDER)
    target = samples[ORDER:].ravel().astype(np.float64)
    weights = np.linalg.lstsq(flat.T @ flat, flat.T @ target, rcond=None)[0]
    coefficients = np.rint(np.clip(weights, -8.0, 8.0) * _COEFFICIENT_SCALE)
    residuals = samples.copy()
    # A stretch begins with a sample as it is, then each is predicted from the one before until there are enough of them.
    residuals[1:ORDER] -= samples[: ORDER - 1]
    residuals[ORDER:] -= _rounded(past @ coefficients).astype(np.int64)
    folded = _folded(np.ascontiguousarray(residuals).view(np.uint64).ravel(), bits)
    return _planes(PREDICTION, folded, coefficients.astype(_HEADER).tobytes())


def _rounded(weighted: NDArray[np.float64]) -> NDArray[np.float64]:
    """Whole-number prediction from a weighted sum. All numbers are whole and below 2**53: the same on every machine."""
    return np.floor((weighted + _COEFFICIENT_SCALE / 2) / _COEFFICIENT_SCALE)


@cache
def _compiled_module() -> ModuleType | None:
    """compiled_columns, None where the fast extra is not installed."""
    try:
        with interrupts_held():
            from yieldmon.bus.packed import compiled_columns
    except ImportError:
        return None
    return compiled_columns


def _from_differences(coded: Coded, count: int, bits: int, *, compiled: bool) -> Column:
    module = _compiled_module() if compiled else None
    if module is not None:
        column: Column = module.from_differences(_planes_in(coded.data, coded.width, count), bits)
        return column
    differences = _unfolded(_from_planes(coded.data, coded.width, count), bits)
    return np.cumsum(differences, dtype=np.uint64) & _mask(bits)


def _from_predicted(coded: Coded, count: int, bits: int, *, compiled: bool) -> Column:
    start = ORDER * _HEADER.itemsize
    coefficients = np.frombuffer(coded.data[:start], _HEADER).astype(np.float64)
    stretches = _stretches(count)
    module = _compiled_module() if compiled else None
    if module is not None:
        planes = _planes_in(coded.data[start:], coded.width, stretches * _STRETCH)
        column: Column = module.from_predicted(planes, coefficients, _STRETCH, bits, _COEFFICIENT_SCALE)[:count]
        return column
    residuals = _unfolded(_from_planes(coded.data[start:], coded.width, stretches * _STRETCH), bits)
    samples = residuals.astype(np.float64).reshape(_STRETCH, stretches)
    modulus = float(1 << bits)
    for row in range(1, _STRETCH):
        value = samples[row]
        value += samples[row - 1] if row < ORDER else _rounded(coefficients @ samples[row - ORDER : row])
        value -= modulus * np.floor(value / modulus)
    return samples.T.reshape(-1)[:count].astype(np.uint64)
