"""Part of the noise that does not follow the force and is therefore not caused by kernels.

The power of kernel noise is proportional to the rate of impacts, so it follows the force over the paddle pattern (Campbell's
theorem, locally). Vibration of the machine continues between the pulses. Noise at phases without grain, beyond that of the empty
machine, is caused by the harvesting machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.physics.numerics import AnyArray, Array

BINS = 64
_OF_THE_PATTERN = 4
"""Steady noise is estimated in 1 / this of the pattern, where the force is least."""
_MOST_FORCE = 0.2
"""Largest force there, relative to the mean force."""
_BANDWIDTH = 2.0 / 3.0
"""Effective bandwidth of a half sine weight relative to its width, for the scatter of the mean power."""


@dataclass(frozen=True, slots=True)
class PhaseNoise:
    """Sums over a window's samples by the phase of the paddle pattern.

    Attributes
    ----------
    power_n2, force_n, samples : ndarray (b,)
        Sum of squares of the samples in the band, sum of the force, and number of samples in each bin.
    """

    power_n2: Array
    force_n: Array
    samples: Array


@dataclass(frozen=True, slots=True)
class SteadyNoise:
    """Noise that stays between the pulses, beyond that of the empty machine.

    Attributes
    ----------
    share : float
        Share of the noise beyond that of the empty machine, reduced by what chance explains; 0 if there is no time between the
        pulses.
    sd : float
        Its standard deviation by chance; inf if it cannot be measured.
    """

    share: float
    sd: float


_UNSEEN = SteadyNoise(0.0, float("inf"))


def _weights(frequency_hz: AnyArray, low_hz: float, high_hz: float) -> Array:
    """Amplitude weights: a half sine over the band, which has a short impulse response; 0 for an empty band."""
    if not high_hz > low_hz:
        return np.zeros(frequency_hz.shape)
    place = (frequency_hz - low_hz) / (high_hz - low_hz)
    return np.where((place > 0.0) & (place < 1.0), np.sin(np.pi * place), 0.0)


def noise_by_phase(
    left_n: Array, force_n: Array, phase: Array, *, interval_s: float, low_hz: float, high_hz: float
) -> PhaseNoise:
    """Power of noise in a band, and the force, by phase.

    Parameters
    ----------
    left_n : ndarray (n,)
        Samples minus the mean pulses, N.
    force_n : ndarray (n,)
        The samples themselves, N.
    phase : ndarray (n,)
        Their phase, in turns of the pattern.
    interval_s : float
        Between two samples, s.
    low_hz, high_hz : float
        Ends of the band, Hz; no power unless low_hz < high_hz.

    Returns
    -------
    PhaseNoise
        With `BINS` bins.

    Source: Campbell, "The study of discontinuous phenomena", Proc. Camb. Phil. Soc. 15 (1909), for noise in proportion to the
    rate of impacts.
    """
    waves = np.fft.rfft(left_n)
    waves *= _weights(np.fft.rfftfreq(left_n.size, interval_s), low_hz, high_hz)
    in_band = np.fft.irfft(waves, left_n.size)
    place = ((phase - np.floor(phase)) * BINS).astype(np.intp) % BINS
    sums = (np.bincount(place, weights=weights, minlength=BINS) for weights in (in_band * in_band, force_n, None))
    return PhaseNoise(*(np.asarray(values, dtype=np.float64) for values in sums))


def band_power(frequency_hz: Array, density: Array, low_hz: float, high_hz: float) -> float:
    """Mean square of noise in the band, with the weights of `noise_by_phase`.

    Parameters
    ----------
    frequency_hz : ndarray (k,)
        Evenly spaced, Hz.
    density : ndarray (k,)
        Two-sided power density, N^2/Hz.
    low_hz, high_hz : float
        Ends of the band, Hz.

    Returns
    -------
    float
        N^2.
    """
    spacing_hz = float(frequency_hz[1] - frequency_hz[0])
    return 2.0 * spacing_hz * float((_weights(frequency_hz, low_hz, high_hz) ** 2 * density).sum())


def steady_noise(
    parts: Sequence[PhaseNoise],
    impulses: Sequence[float],
    *,
    quiet_n2: float,
    pattern_s: float,
    interval_s: float,
    low_hz: float,
    high_hz: float,
) -> SteadyNoise:
    """Share of noise that does not depend on the force: noise at the least force, minus that of kernels at that force.

    Parameters
    ----------
    parts : sequence of PhaseNoise (w,)
        Windows with grain, one or more.
    impulses : sequence of float (w,)
        Force per mass flow in each window, N s/kg, to which a kernel's impulse is proportional.
    quiet_n2 : float
        `band_power` of the empty machine, N^2.
    pattern_s : float
        Duration of one turn of the pattern, s.
    interval_s, low_hz, high_hz : float
        As in `noise_by_phase`.

    Returns
    -------
    SteadyNoise
        Share 0 and infinite standard deviation if no part of the pattern is without force.

    Raises
    ------
    ValueError
        If the numbers of impulses and windows differ.
    """
    samples = np.sum([part.samples for part in parts], axis=0)
    power = np.sum([part.power_n2 for part in parts], axis=0)
    force = np.sum([impulse * part.force_n for impulse, part in zip(impulses, parts, strict=True)], axis=0)
    beyond = float(power.sum() / samples.sum()) - quiet_n2
    if not (samples.min() > 0.0 and beyond > 0.0):
        return _UNSEEN
    seen = _as_the_band_sees(force / samples, pattern_s, high_hz - low_hz)
    valley = np.argsort(seen)[: BINS // _OF_THE_PATTERN]
    follows = max(float(seen[valley].mean() / seen.mean()), 0.0)
    if not follows < _MOST_FORCE:
        return _UNSEEN
    count = float(samples[valley].sum())
    there = float(power[valley].sum()) / count
    share = ((there - quiet_n2) / beyond - follows) / (1.0 - follows)
    sd = there / beyond / (1.0 - follows) / np.sqrt(_BANDWIDTH * (high_hz - low_hz) * interval_s * count)
    if not share > 0.0:
        return SteadyNoise(0.0, float(sd))
    return SteadyNoise(min(share, 1.0) * share**2 / (share**2 + sd**2), float(sd))


def _as_the_band_sees(force_n: Array, pattern_s: float, width_hz: float) -> Array:
    """The force over the phase, smoothed by the squared impulse response of the band."""
    lag = np.minimum(np.arange(BINS // 2 + 1) / (pattern_s * width_hz), 1.0)
    # Autocorrelation of a half sine at lags relative to its width.
    like = (1.0 - lag) * np.cos(np.pi * lag) + np.sin(np.pi * lag) / np.pi
    return np.asarray(np.fft.irfft(np.fft.rfft(force_n) * like, BINS))
