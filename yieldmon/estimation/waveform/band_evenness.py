"""Test whether noise attributed to kernels has an even spectral density over its band, as that of kernels has."""

from __future__ import annotations

import numpy as np

from yieldmon.physics.numerics import Array

_SHORTEST_CELL_S = 1e-5
"""Least time constant of the cell in the comparison with another cell."""
_PUSHING = -0.4
"""Steepest exponent of the frequency for noise of kernels, whose push has a duration (studies/waveform, `kernels`)."""
_FREE_TILT = 1.5
"""Standard deviations by which the halves of a band may differ beyond what kernels explain without consequence."""


def uneven_sd(
    above: Array,
    gain: Array,
    *,
    impulse_n_s: float,
    weight: Array,
    variance: Array,
    ground_sd: Array,
    cell_sd: Array,
    frequency_hz: Array,
    cell_response_s: float,
) -> float:
    """Relative standard deviation of a kernel's impulse by a spectral density that differs from that of kernels.

    Parameters
    ----------
    above : ndarray (k,)
        Density beyond that of the empty machine, N^2/Hz.
    gain : ndarray (k,)
        Mean force times the power gain of cell and sampler, so that above = impulse * gain.
    impulse_n_s : float
        Kernel impulse from the whole band.
    weight, variance : ndarray (k,)
        Weight of the frequencies in the impulse, and variance of `above` by chance.
    ground_sd, cell_sd : ndarray (k,)
        Standard deviations of the empty machine's density, and of ln gain by the cell's time constant; each is fully correlated
        over the frequencies.
    frequency_hz : ndarray (k,)
    cell_response_s : float
        Time constant of the cell; 0 for none.

    Returns
    -------
    float
        The larger of two errors: half the difference between the band's halves beyond their standard deviations, and the error of
        a wrong time constant that would explain that difference. 0 if chance, background and cell explain the difference.
    """
    per_half = _halves(above, gain, weight, variance, ground_sd, cell_sd) / impulse_n_s
    middles_hz, lever = _as_another_cell_tilts(frequency_hz, weight * gain, cell_response_s)
    return max(_unevenness(per_half), lever * _beyond_kernels(per_half, middles_hz))


def _halves(above: Array, gain: Array, weight: Array, variance: Array, ground_sd: Array, cell_sd: Array) -> Array:
    """Rows (impulse, its standard deviations by chance, background and cell) of the lower and upper half of a band, N s, (2,
    4)."""
    rows = []
    for half in (slice(None, gain.size // 2), slice(gain.size // 2, None)):
        w, slope = weight[half], float((weight[half] * gain[half]).sum())
        impulse = float((w * above[half]).sum()) / slope
        chance = float(np.sqrt((w**2 * variance[half]).sum())) / slope
        of_cell = impulse * float((w * gain[half] * cell_sd[half]).sum()) / slope
        rows.append((impulse, chance, float((w * ground_sd[half]).sum()) / slope, of_cell))
    return np.array(rows)


def _unevenness(per_half: Array) -> float:
    """Half the difference between the halves of a band beyond their standard deviations; background and cell are common to
    both."""
    apart = per_half[1] - per_half[0]
    expected = float((per_half[:, 1] ** 2).sum() + apart[2] ** 2 + apart[3] ** 2)
    return 0.5 * float(np.sqrt(max(0.0, float(apart[0]) ** 2 - expected)))


def _as_another_cell_tilts(frequency_hz: Array, weight: Array, cell_response_s: float) -> tuple[Array, float]:
    """Effect of a wrong time constant of the cell.

    Parameters
    ----------
    frequency_hz : ndarray (k,)
    weight : ndarray (k,)
        Of the frequencies in the impulse.
    cell_response_s : float

    Returns
    -------
    ndarray (2,)
        Middles of the band's halves, Hz.
    float
        Relative error of the impulse per difference of ln(impulse) between the halves.
    """
    turned = (2.0 * np.pi * frequency_hz * max(cell_response_s, _SHORTEST_CELL_S)) ** 2
    change = turned / (1.0 + turned)
    half = frequency_hz.size // 2
    means = [
        (float((w * f).sum() / w.sum()), float((w * c).sum() / w.sum()))
        for f, c, w in zip(*((v[:half], v[half:]) for v in (frequency_hz, change, weight)), strict=True)
    ]
    (low_hz, low), (high_hz, high) = means
    return np.array([low_hz, high_hz]), float((weight * change).sum() / weight.sum()) / (high - low)


def _beyond_kernels(per_half: Array, middles_hz: Array) -> float:
    """Difference of ln(impulse) between the halves of a band beyond what kernels and `_FREE_TILT` standard deviations explain.

    Kernels that bounce off at once cause no difference; those that keep pushing cause one between 0 and the frequency to the
    power of `_PUSHING`.
    """
    if not per_half[:, 0].min() > 0.0:
        return 0.0
    apart = per_half[1] - per_half[0]
    chance = float(np.sqrt((per_half[:, 1] ** 2).sum() + apart[2] ** 2 + apart[3] ** 2))
    tilt, pushing = (float(np.log(v[1] / v[0])) for v in (per_half[:, 0], middles_hz**_PUSHING))
    return max(0.0, max(tilt, pushing - tilt) - _FREE_TILT * chance)
