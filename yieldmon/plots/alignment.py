"""Time of a truth beside the record of a log that was given another start time."""

from __future__ import annotations

import numpy as np

from yieldmon.physics.numerics import Array

_LEAST_OVERLAP = 0.5
"""Of the shorter of the two."""


def shift_s(time_s: Array, measured_kg_s: Array, true_time_s: Array, true_kg_s: Array) -> float:
    """Whole seconds to add to the truth's time, so that its flow lies on the measured one with the least mean square.

    Parameters
    ----------
    time_s, measured_kg_s : ndarray, shape (n,)
        Record, s and kg/s, nan where there is no flow.
    true_time_s, true_kg_s : ndarray, shape (m,)
        Truth, a row a second.

    Returns
    -------
    float
        Where flows do not determine it, the shift that lets both end together.
    """
    start, true_start = float(np.floor(time_s[0])), float(np.floor(true_time_s[0]))
    ends = float(np.round(time_s[-1] - true_time_s[-1]))
    known = np.isfinite(measured_kg_s)
    if not known.any() or float(np.ptp(true_kg_s)) == 0.0:
        return ends
    place = np.floor(time_s[known]).astype(np.int64) - int(start)
    length = int(place.max()) + 1
    here, flow = np.zeros(length), np.zeros(length)
    here[place], flow[place] = 1.0, measured_kg_s[known]
    grid = np.interp(true_start + np.arange(int(true_time_s[-1] - true_start) + 1), true_time_s, true_kg_s)
    there = np.ones(len(grid))
    count = np.round(_lagged(here, there))
    square = _lagged(flow * flow, there) - 2.0 * _lagged(flow, grid) + _lagged(here, grid * grid)
    enough = count >= max(1.0, _LEAST_OVERLAP * min(here.sum(), len(grid)))
    mean_square = np.where(enough, square / np.maximum(count, 1.0), np.inf)
    lag = int(np.argmin(mean_square)) - (len(grid) - 1)
    return start - true_start + lag


def _lagged(a: Array, b: Array) -> Array:
    """Sum over i of a[i + lag] b[i], for lags from 1 - len(b) to len(a) - 1."""
    size = len(a) + len(b) - 1
    spectrum = np.fft.rfft(a, size) * np.fft.rfft(b[::-1], size)
    return np.asarray(np.fft.irfft(spectrum, size))
