"""Columns of packed frames in code that numba compiles (the fast extra): what `columns` does, number by number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.interrupts import interrupts_held
from yieldmon.bus.log_files.compiled import compiled
from yieldmon.bus.packed.columns import ORDER

_LANES = 16
"""Stretches worked out side by side: vector instructions of all widths are filled, and their samples stay in the cache."""


@interrupts_held()
def from_differences(planes: NDArray[np.uint8], bits: int) -> NDArray[np.uint64]:
    """The numbers of a column of differences.

    Parameters
    ----------
    planes : uint8 array, shape (width, n)
        Folded differences by their bytes, lowest first.
    bits : int
        Of a number.

    Returns
    -------
    uint64 array, shape (n,)
    """
    numbers: NDArray[np.uint64] = _differences(planes, bits)
    return numbers


@interrupts_held()
def from_predicted(
    planes: NDArray[np.uint8], coefficients: NDArray[np.float64], stretch: int, bits: int, scale: float
) -> NDArray[np.uint64]:
    """The samples of a predicted column, the last stretch filled up.

    Parameters
    ----------
    planes : uint8 array, shape (width, stretch * stretches)
        Residuals by their bytes, lowest first; stretches side by side.
    coefficients : array, shape (8,)
        Whole numbers, in 1 / scale.
    stretch : int
        Samples in a stretch.
    bits : int
        Of a sample.
    scale : float
        A power of two.

    Returns
    -------
    uint64 array, shape (stretch * stretches,)
    """
    samples: NDArray[np.uint64] = _predicted(planes, coefficients, stretch, bits, scale)
    return samples


@interrupts_held()
def place_fields(payload: NDArray[np.uint64], column: NDArray[np.uint64], starts: NDArray[np.uint64]) -> None:
    """See columns.place_fields."""
    _place_fields(payload, column, starts)


@compiled
def _place_fields(payload, column, starts):  # type: ignore[no-untyped-def]
    per_frame = len(starts)
    for at in range(len(payload)):
        data = payload[at]
        for place in range(per_frame):
            data |= column[at * per_frame + place] << starts[place]
        payload[at] = data


@compiled
def _mask(bits):  # type: ignore[no-untyped-def]
    return ~np.uint64(0) >> np.uint64(64 - bits)


@compiled
def _unfolded(folded):  # type: ignore[no-untyped-def]
    return (folded >> np.uint64(1)) ^ (np.uint64(0) - (folded & np.uint64(1)))


@compiled
def _gather(planes, at, numbers, count):  # type: ignore[no-untyped-def]
    """The numbers from a place on, a plane at a time, which takes vector instructions."""
    for place in range(count):
        numbers[place] = np.uint64(planes[0, at + place])
    for plane in range(1, len(planes)):
        for place in range(count):
            numbers[place] |= np.uint64(planes[plane, at + place]) << np.uint64(8 * plane)


@compiled
def _differences(planes, bits):  # type: ignore[no-untyped-def]
    width, count = planes.shape
    mask = _mask(bits)
    out = planes[0].astype(np.uint64)
    for plane in range(1, width):
        for at in range(count):
            out[at] |= np.uint64(planes[plane, at]) << np.uint64(8 * plane)
    total = np.uint64(0)
    for at in range(count):
        total += _unfolded(out[at])
        out[at] = total & mask
    return out


@compiled
def _predicted(planes, coefficients, stretch, bits, scale):  # type: ignore[no-untyped-def]
    count = planes.shape[1]
    stretches = count // stretch
    mask = _mask(bits)
    modulus = float(mask) + 1.0
    # Of powers of two, so that products with them are exact.
    per_scale, per_modulus = 1.0 / scale, 1.0 / modulus
    out = np.empty((stretches, stretch), np.uint64)
    samples, folded = np.empty((stretch, _LANES)), np.empty(_LANES, np.uint64)
    for first in range(0, stretches, _LANES):
        lanes = min(_LANES, stretches - first)
        for row in range(stretch):
            at = row * stretches + first
            _gather(planes, at, folded, lanes)
            for lane in range(lanes):
                samples[row, lane] = float(np.int64(_unfolded(folded[lane]) & mask))
            if row >= ORDER:
                for lane in range(lanes):
                    weighted = 0.0
                    for k in range(ORDER):
                        weighted += coefficients[k] * samples[row - ORDER + k, lane]
                    samples[row, lane] += np.floor((weighted + scale / 2) * per_scale)
            elif row:
                for lane in range(lanes):
                    samples[row, lane] += samples[row - 1, lane]
            for lane in range(lanes):
                samples[row, lane] -= modulus * np.floor(samples[row, lane] * per_modulus)
        for lane in range(lanes):
            for row in range(stretch):
                out[first + lane, row] = np.uint64(np.int64(samples[row, lane]))
    return out.reshape(-1)
