"""Samples folded on the paddle pattern: mean pulse, its scatter, and its harmonics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, Array


@dataclass(frozen=True, slots=True)
class PatternWave:
    """Harmonics of the force over the paddle pattern.

    Attributes
    ----------
    amplitudes_n : ndarray (k,)
        Complex: mean of F(t) exp(-i w_k t) for the harmonics 1 .. k, N.
    noise_n : ndarray (k,)
        Standard deviation of real and imaginary part each, from noise that averages out over time, N.
    patterns : float
        Number of turns of the pattern that were averaged.
    elevator_speed_rad_s, plate_angle_rad : float
    """

    amplitudes_n: AnyArray
    noise_n: Array
    patterns: float
    elevator_speed_rad_s: float
    plate_angle_rad: float


@dataclass(frozen=True, slots=True)
class FoldedPattern:
    """Mean of the samples over the phase of the paddle pattern.

    Attributes
    ----------
    mean_n : ndarray (b,)
        Mean in b equal bins of phase; nan in a bin without samples.
    variance_n2 : ndarray (b,)
        Variance of a sample about its bin's mean, by noise and by the scatter of pulses.
    counts : ndarray (b,)
        Number of samples.
    patterns : float
        Number of turns of the pattern that the samples cover.
    """

    mean_n: Array
    variance_n2: Array
    counts: Array
    patterns: float

    @property
    def complete(self) -> bool:
        """Whether every bin has a sample and at least two patterns were covered."""
        return bool((self.counts > 0).all() and self.patterns >= 2.0)


def fold_all(samples_n: Sequence[Array], phases: Sequence[Array], *, bins: int = 64) -> list[FoldedPattern]:
    """Fold the samples (n,) of each window by their phase (n,), in turns of the pattern along the chain.

    The result for a window is bit for bit independent of the others.
    """
    count, sizes = len(phases), [phase.size for phase in phases]
    if not count:
        return []
    samples, phase = np.concatenate(samples_n), np.concatenate(phases)
    place = np.floor((phase % 1.0) * bins).astype(np.intp) % bins + bins * np.repeat(np.arange(count), sizes)
    counts = np.bincount(place, minlength=count * bins).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(place, weights=samples, minlength=count * bins) / counts
        square = np.bincount(place, weights=(samples - mean[place]) ** 2, minlength=count * bins) / np.maximum(counts - 1.0, 1.0)
    turns = [float(np.ptp(phase)) if phase.size else 0.0 for phase in phases]
    tables = (table.reshape(count, bins) for table in (mean, square, counts))
    return [FoldedPattern(*row) for row in zip(*tables, turns, strict=True)]


def harmonics_of_all(
    folded: Sequence[FoldedPattern],
    harmonics: int,
    *,
    elevator_speeds_rad_s: Sequence[float],
    plate_angles_rad: Sequence[float],
) -> list[PatternWave]:
    """Harmonics 1 .. `harmonics` of complete patterns with equal numbers of bins. Their noise comes from the scatter in the bins.

    Raises
    ------
    ValueError
        For an incomplete pattern, or more harmonics than a third of the bins.
    """
    if not folded:
        return []
    bins = folded[0].mean_n.size
    for pattern in folded:
        if not pattern.complete:
            raise ValueError(
                f"{int((pattern.counts == 0).sum())} of {bins} bins without samples, {pattern.patterns:.2f} patterns"
            )
    if 3 * harmonics > bins:
        raise ValueError(f"{harmonics} harmonics from {bins} bins, expected at most a third")
    order = np.arange(1, harmonics + 1)
    # The mean over a bin is the value at its middle, low-pass filtered by the bin's width.
    width = np.sinc(order / bins)
    turned = np.exp(-1j * np.pi * order / bins) / width
    waves = np.fft.fft(np.array([pattern.mean_n for pattern in folded]))[:, 1 : harmonics + 1] / bins * turned
    of_means = np.array([pattern.variance_n2 / pattern.counts for pattern in folded]).sum(axis=1) / bins**2
    noise = np.sqrt(0.5 * of_means)[:, None] / width
    rows = zip(waves, noise, folded, elevator_speeds_rad_s, plate_angles_rad, strict=True)
    return [PatternWave(wave, sd, pattern.patterns, speed, angle) for wave, sd, pattern, speed, angle in rows]


def later(wave: PatternWave, turns: float) -> PatternWave:
    """The same pulses, delayed by some turns of the pattern."""
    order = np.arange(1, wave.amplitudes_n.size + 1)
    return replace(wave, amplitudes_n=wave.amplitudes_n * np.exp(-2j * np.pi * turns * order))
