"""Predicted columns of packed frames in code that numba compiles (the fast extra): what packed_columns does, number by number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.compiled import compiled


def from_predicted(
    planes: NDArray[np.uint8], coefficients: NDArray[np.float64], stretch: int, bits: int, scale: float
) -> NDArray[np.uint64]:
    """The samples of a predicted column, the last stretch filled up.

    Parameters
    ----------
    planes : uint8 array, shape (width, stretch * stretches)
        Residuals by their bytes, lowest first; stretches side by side.
    coefficients : array, shape (order,)
        Whole numbers, in 1 / scale.
    stretch : int
        Samples in a stretch.
    bits : int
        Of a sample.
    scale : float

    Returns
    -------
    uint64 array, shape (stretch * stretches,)
    """
    samples: NDArray[np.uint64] = _predicted(planes, coefficients, stretch, bits, scale)
    return samples


@compiled
def _predicted(planes, coefficients, stretch, bits, scale):  # type: ignore[no-untyped-def]
    width, count = planes.shape
    order, stretches = len(coefficients), count // stretch
    mask = np.uint64((np.uint64(1) << np.uint64(bits)) - np.uint64(1))
    modulus = float(mask) + 1.0
    samples = np.empty((stretches, stretch), np.float64)
    out = np.empty((stretches, stretch), np.uint64)
    for part in range(stretches):
        for row in range(stretch):
            folded = np.uint64(0)
            for plane in range(width):
                folded |= np.uint64(planes[plane, row * stretches + part]) << np.uint64(8 * plane)
            residual = (folded >> np.uint64(1)) & mask
            if folded & np.uint64(1):
                residual = ~(folded >> np.uint64(1)) & mask
            value = float(residual)
            if 0 < row < order:
                value += samples[part, row - 1]
            elif row >= order:
                weighted = 0.0
                for k in range(order):
                    weighted += coefficients[k] * samples[part, row - order + k]
                value += np.floor((weighted + scale / 2) / scale)
            if row:
                value -= modulus * np.floor(value / modulus)
            samples[part, row] = value
            out[part, row] = np.uint64(value)
    return out.reshape(-1)
