"""What pulses that come early or late leave in the noise of kernels.

The phase of the paddle pattern comes from a few speeds a second and from spacings that are taken for exact. A chain that jerks or
a paddle that is bent puts pulses out of place, and what is then left of them looks like kernels. How far they are out of place
shows in their own times, of which the kernels explain a part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.estimation.gaussian import SD_PER_MAD
from yieldmon.physics.numerics import Array, median

_LEAST_PULSES = 20
_MOST_BLURRED = 3.0
"""Exponent up to which a mean of pulses out of place is made as steep as they are; beyond, its own chance would be."""


@dataclass(frozen=True, slots=True)
class PulseTimes:
    """Of one window.

    Attributes
    ----------
    away_s : ndarray (p,)
        Each pulse's time after the median of them.
    left_n2 : float
        Mean square that pulses so far from the mean pulse leave in the band.
    by_kernels_s_n : float
        Variance of such a time by chance for each newton second of a kernel's impulse, s/N.
    frequency_hz, steepness_n2_s2 : ndarray (k,)
        Mean square of the mean pulse's slope at the frequencies of the band: times the variance of the pulses' times it is what
        they leave there.
    """

    away_s: Array
    left_n2: float
    by_kernels_s_n: float
    frequency_hz: Array
    steepness_n2_s2: Array


def pulse_times(late_turns: Array, mean_n: Array, *, pulses: int, pattern_s: float, low_hz: float, high_hz: float) -> PulseTimes:
    """The times of a window's pulses, and what they stand for.

    Parameters
    ----------
    late_turns : ndarray (p,)
        In turns of the pattern, of whole pulses (`pattern_fold.residual_of_pulses`).
    mean_n : ndarray (b,)
        Mean pulses over the pattern, N.
    pulses : int
        Of the pattern.
    pattern_s : float
        In which the pattern passes.
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
    # Beyond the band there is little but the chance of the mean.
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
    # Of a pulse far out of place no more is left than it and the mean pulse hold.
    apart_s2 = (2.0 - 2.0 * np.cos(turned_s[:, None] * away_s)).sum(axis=1) / (max(away_s.size, 1) * turned_s**2)
    return PulseTimes(away_s, float((steepness * apart_s2).sum()), by_kernels, frequency[within], steepness)


def misplaced_share(windows: Sequence[PulseTimes], impulse_n_s: float, power_n2: Sequence[float]) -> float:
    """Share of the noise in the band that pulses out of place have left there.

    Where most of them are out of place, as by a chain that jerks, their mean is less steep than they are, by a Gaussian of the
    scatter of the middle half; a few, as of a bent paddle, do not blur it.

    Parameters
    ----------
    windows : sequence of PulseTimes (w,)
    impulse_n_s : float
        Of a kernel, by the noise.
    power_n2 : sequence of float (w,)
        Mean square in the band beyond the empty machine's, of each window.

    Returns
    -------
    float
        0 where kernels explain the pulses' times, with fewer than twenty pulses, and without noise.
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
