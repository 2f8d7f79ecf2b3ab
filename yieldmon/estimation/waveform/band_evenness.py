"""Whether what is taken for the noise of kernels is even over its band, as theirs is."""

from __future__ import annotations

import numpy as np

from yieldmon.physics.numerics import Array

_SHORTEST_CELL_S = 1e-5
"""A cell without lag counts as one of this time constant where the tilt of another one is compared with it."""
_PUSHING = -0.4
"""Exponent of the frequency by which the noise of kernels falls at most, for a push lasts (studies/waveform, `kernels`)."""
_FREE_TILT = 1.5
"""Deviations by which the halves of a band may differ beyond kernels before the rest counts."""


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
    """Relative standard deviation of a kernel's impulse for a density that is not that of kernels over the whole band.

    Parameters
    ----------
    above : ndarray (k,)
        Density beyond that of the empty machine, N^2/Hz.
    gain : ndarray (k,)
        Mean force times the share of a white density that the samples show, so that above is impulse times gain.
    impulse_n_s : float
        By the whole band.
    weight, variance : ndarray (k,)
        Of the frequencies in the impulse, and of above by chance.
    ground_sd, cell_sd : ndarray (k,)
        Standard deviations of the empty machine's density, and of ln gain by the cell's time constant; each errs the same way at
        all frequencies.
    frequency_hz : ndarray (k,)
    cell_response_s : float
        Time constant of the cell; 0 for none.

    Returns
    -------
    float
        The larger of half of what the band's halves differ by beyond their deviations, and of what another cell would err by
        that tilts the band as it is tilted. 0 where chance, background and cell explain what the halves differ by.
    """
    per_half = _halves(above, gain, weight, variance, ground_sd, cell_sd) / impulse_n_s
    middles_hz, lever = _as_another_cell_tilts(frequency_hz, weight * gain, cell_response_s)
    return max(_unevenness(per_half), lever * _beyond_kernels(per_half, middles_hz))


def _halves(above: Array, gain: Array, weight: Array, variance: Array, ground_sd: Array, cell_sd: Array) -> Array:
    """Impulse by the lower and the upper half of a band, and its deviations by chance, background and cell (2, 4), all N s."""
    rows = []
    for half in (slice(None, gain.size // 2), slice(gain.size // 2, None)):
        w, slope = weight[half], float((weight[half] * gain[half]).sum())
        impulse = float((w * above[half]).sum()) / slope
        chance = float(np.sqrt((w**2 * variance[half]).sum())) / slope
        of_cell = impulse * float((w * gain[half] * cell_sd[half]).sum()) / slope
        rows.append((impulse, chance, float((w * ground_sd[half]).sum()) / slope, of_cell))
    return np.array(rows)


def _unevenness(per_half: Array) -> float:
    """Half of what two halves of a band differ by beyond their deviations; background and cell err in both alike."""
    apart = per_half[1] - per_half[0]
    expected = float((per_half[:, 1] ** 2).sum() + apart[2] ** 2 + apart[3] ** 2)
    return 0.5 * float(np.sqrt(max(0.0, float(apart[0]) ** 2 - expected)))


def _as_another_cell_tilts(frequency_hz: Array, weight: Array, cell_response_s: float) -> tuple[Array, float]:
    """Middles of the band's halves, Hz, and by what share of the impulse another time constant errs for what it tilts them.

    weight: of the frequencies in the impulse. The lever is the mean over the band of the change of ln(gain) over the difference
    of its means over the halves.
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
    """By how much ln(impulse) differs between two halves of a band beyond what kernels and `_FREE_TILT` deviations explain.

    Kernels that strike and leave differ by nothing, those that go on pushing as the frequency to the power of `_PUSHING`.
    """
    if not per_half[:, 0].min() > 0.0:
        return 0.0
    apart = per_half[1] - per_half[0]
    chance = float(np.sqrt((per_half[:, 1] ** 2).sum() + apart[2] ** 2 + apart[3] ** 2))
    tilt, pushing = (float(np.log(v[1] / v[0])) for v in (per_half[:, 0], middles_hz**_PUSHING))
    return max(0.0, max(tilt, pushing - tilt) - _FREE_TILT * chance)
