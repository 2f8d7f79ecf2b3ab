"""Spectral density of a stretch of samples, and means of such densities.

Source: Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

_HANN_NEIGHBOURS = 1.0 + 2.0 * ((2.0 / 3.0) ** 2 + (1.0 / 6.0) ** 2)
"""Ratio of the variance of a sum over frequencies to that of independent ones, since neighbours in a Hann spectrum correlate."""


@dataclass(frozen=True, slots=True)
class Density:
    """Spectral density of a signal.

    Attributes
    ----------
    frequency_hz : ndarray (k,)
    density : ndarray (k,)
        Two-sided, N^2/Hz: its sum over positive and negative frequencies times their spacing is the mean square.
    averages : float
        Effective number of independent averaged segments for sums over many frequencies; it is reduced by the correlation of
        neighbouring frequencies.
    """

    frequency_hz: Array
    density: Array
    averages: float


def density(samples_n: Array, sample_interval_s: float, *, segment: int = 256) -> Density:
    """Averaged spectral density of a stretch of samples; see `densities`."""
    return densities((samples_n,), sample_interval_s, segment=segment)[0]


def densities(stretches_n: Sequence[Array], sample_interval_s: float, *, segment: int = 256) -> list[Density]:
    """Averaged spectral density of each stretch of samples (Welch, Hann window, half overlapped).

    Parameters
    ----------
    stretches_n : sequence of ndarray (n,)
        Evenly spaced samples, none missing.
    sample_interval_s : float
    segment : int
        Number of samples in a segment, at most n.

    Returns
    -------
    list of Density
        Frequencies above 0 and below Nyquist. Each density is bit for bit independent of the other stretches.

    Raises
    ------
    ValueError
        For fewer samples than one segment.
    """
    counts = [(len(stretch) - segment) // (segment // 2) + 1 for stretch in stretches_n]
    if not counts:
        return []
    if min(counts) < 1:
        raise ValueError(f"{min(map(len, stretches_n))} samples, expected at least one segment of {segment}")
    window, power_of_window = _hann(segment)
    parts = np.concatenate(
        [np.asarray(stretch, dtype=float)[_segments(count, segment)] for stretch, count in zip(stretches_n, counts, strict=True)]
    )
    parts -= (parts.sum(axis=1) / segment)[:, None]
    parts *= window
    waves = np.fft.rfft(parts)
    powers = np.split(waves.real**2 + waves.imag**2, np.cumsum(counts)[:-1])
    frequency_hz = frequencies_hz(segment, sample_interval_s)
    found = []
    for power, count in zip(powers, counts, strict=True):
        # Hann segments that overlap by half: 1 / (1 + 2 (1/6)^2) of their number are independent (Welch, 1967).
        independent = count if count == 1 else count / (1.0 + 2.0 * (1.0 - 1.0 / count) / 36.0)
        mean = power.sum(axis=0) * (sample_interval_s / (power_of_window * count))
        found.append(Density(frequency_hz, mean[1:-1], independent / _HANN_NEIGHBOURS))
    return found


@lru_cache(maxsize=8)
def _hann(segment: int) -> tuple[Array, float]:
    """The window, and the sum of its squares."""
    window = np.hanning(segment + 1)[:-1]
    window.flags.writeable = False
    return window, float((window**2).sum())


@lru_cache(maxsize=8)
def _segments(count: int, segment: int) -> NDArray[np.intp]:
    """Indices (count, segment) of the samples in segments that overlap by half."""
    places = np.arange(count)[:, None] * (segment // 2) + np.arange(segment)
    places.flags.writeable = False
    return places


@lru_cache(maxsize=8)
def frequencies_hz(segment: int, sample_interval_s: float) -> Array:
    """Frequencies of a density, above 0 and below Nyquist, Hz, (k,)."""
    frequency: Array = np.asarray(np.fft.rfftfreq(segment, sample_interval_s)[1:-1], dtype=np.float64)
    frequency.flags.writeable = False
    return frequency


def expected_averages(duration_s: float, sample_interval_s: float, *, segment: int = 256) -> float:
    """`Density.averages` of a long stretch of samples."""
    return duration_s / (segment * sample_interval_s) * 2.0 / (1.0 + 2.0 / 36.0) / _HANN_NEIGHBOURS


def in_pulses(found: Density, crest: float) -> Density:
    """A density of shot noise in pulses. Kernels strike during part of the time only, so that the density averages out less.

    Parameters
    ----------
    found : Density
    crest : float
        Mean square of the force divided by the square of its mean.
    """
    return replace(found, averages=found.averages / crest)


def pooled(parts: list[Density]) -> Density:
    """Mean of densities on the same frequencies, weighted by their averages."""
    weights = np.array([p.averages for p in parts])
    mean = weights @ np.array([p.density for p in parts]) / weights.sum()
    return Density(parts[0].frequency_hz, mean, float(weights.sum()))
