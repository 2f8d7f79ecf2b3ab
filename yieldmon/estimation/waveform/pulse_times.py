"""Contribution of early or late pulses to the noise attributed to kernels.

The phase of the paddle pattern is computed from a few speed samples per second and nominal spacings. A jerking chain or a bent
paddle displaces pulses, and their residuals look like kernel noise. The displacement is measured by the pulses' times, part of
whose scatter is caused by the kernels themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.estimation.gaussian import SD_PER_MAD
from yieldmon.physics.numerics import Array, median

_LEAST_PULSES = 20
_MOST_BLURRED = 3.0
"""Largest exponent with which the blurring of the mean pulse by displacements is undone; beyond it noise would be amplified."""


@dataclass(frozen=True, slots=True)
class PulseTimes:
    """Times of the pulses in one window.

    Attributes
    ----------
    away_s : ndarray (p,)
        Time of each pulse relative to their median.
    left_n2 : float
        Mean square in the band caused by pulses displaced by `away_s`.
    by_kernels_s_n : float
        Variance of a pulse's time by kernel noise per impulse of a kernel, s/N.
    frequency_hz, steepness_n2_s2 : ndarray (k,)
        Mean square of the mean pulse's slope at the frequencies of the band. Multiplied by the variance of the pulses' times it
        is the mean square that they cause.
    """

    away_s: Array
    left_n2: float
    by_kernels_s_n: float
    frequency_hz: Array
    steepness_n2_s2: Array


def pulse_times(late_turns: Array, mean_n: Array, *, pulses: int, pattern_s: float, low_hz: float, high_hz: float) -> PulseTimes:
    """Times of a window's pulses, and their effect on the noise in the band.

    Parameters
    ----------
    late_turns : ndarray (p,)
        Delay of complete pulses in turns of the pattern (`pulse_residuals.residuals_of_pulses`).
    mean_n : ndarray (b,)
        Mean pulses over the pattern, N.
    pulses : int
        Number of pulses in the pattern.
    pattern_s : float
        Duration of one turn of the pattern, s.
    low_hz, high_hz : float
        Ends of the band.

    Returns
    -------
    PulseTimes

    Source: least squares of a shift under noise whose density follows the force (Campbell's theorem, locally).
    """
    bins = mean_n.size
    waves = np.fft.rfft(mean_n) / bins
    frequency = np.arange(waves.size) / pattern_s
    # Above the band the mean contains little but noise.
    slopes = np.where(frequency <= high_hz, 2.0j * np.pi * frequency * waves, 0.0)
    within = (frequency > 0.0) & (frequency >= low_hz) & (frequency <= high_hz)
    steepness = 2.0 * np.abs(slopes[within]) ** 2
    squares = np.fft.irfft(slopes, bins) ** 2 * bins**2
    step_s, whole = pattern_s / bins, float(squares.sum())
    felt = float((np.maximum(mean_n, 0.0) * squares).sum())
    by_kernels = pulses * felt / (whole**2 * step_s) if whole > 0.0 else 0.0
    late_s = late_turns * pattern_s
    away_s = late_s - median(late_s) if late_s.size else late_s
    turned_s = 2.0 * np.pi * frequency[within]
    # The residual of a pulse that is displaced by far is limited to its own power and that of the mean pulse.
    apart_s2 = (2.0 - 2.0 * np.cos(turned_s[:, None] * away_s)).sum(axis=1) / (max(away_s.size, 1) * turned_s**2)
    return PulseTimes(away_s, float((steepness * apart_s2).sum()), by_kernels, frequency[within], steepness)


def misplaced_share(windows: Sequence[PulseTimes], impulse_n_s: float, power_n2: Sequence[float]) -> float:
    """Share of the noise in the band that is caused by displaced pulses.

    If most pulses are displaced, for example by a jerking chain, their mean is blurred by a Gaussian with the scatter of the
    middle half of the displacements. A few displaced pulses, for example of a bent paddle, do not blur it.

    Parameters
    ----------
    windows : sequence of PulseTimes (w,)
    impulse_n_s : float
        Impulse of a kernel, from the noise.
    power_n2 : sequence of float (w,)
        Mean square in the band beyond the empty machine's, of each window.

    Returns
    -------
    float
        0 if kernel noise explains the pulses' times, for fewer than twenty pulses, or without noise.
    """
    whole = float(sum(power_n2))
    pulses = sum(window.away_s.size for window in windows)
    if pulses < _LEAST_PULSES or not whole > 0.0:
        return 0.0
    middle = median(np.abs(np.concatenate([window.away_s for window in windows])))
    most = (SD_PER_MAD * middle) ** 2 * pulses / max(pulses - len(windows), 1)
    apart_n2 = blurred_n2 = 0.0
    for window in windows:
        if not window.away_s.size:
            continue
        by_chance = impulse_n_s * window.by_kernels_s_n
        apart_n2 += window.left_n2 - by_chance * float(window.steepness_n2_s2.sum())
        beyond = most - by_chance
        if beyond > 0.0:
            sharpened = np.exp(np.minimum(beyond * (2.0 * np.pi * window.frequency_hz) ** 2, _MOST_BLURRED))
            blurred_n2 += beyond * float((window.steepness_n2_s2 * sharpened).sum())
    return max(apart_n2, blurred_n2) / whole
