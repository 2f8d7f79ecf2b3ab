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
        Repeats of the pattern that were averaged.
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
        In b equal bins of phase; nan in a bin without samples.
    variance_n2 : ndarray (b,)
        Of a sample about its bin's mean: noise, and the scatter of pulses.
    counts : ndarray (b,)
        Samples.
    patterns : float
        Turns of the pattern that the samples cover.
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

    Each as if it were alone, to the last bit.
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
    """Harmonics 1 .. `harmonics` of complete patterns with as many bins, with the noise that the scatter within the bins shows.

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
    # The mean over a bin is that at its middle, low-passed by the bin's width.
    width = np.sinc(order / bins)
    turned = np.exp(-1j * np.pi * order / bins) / width
    waves = np.fft.fft(np.array([pattern.mean_n for pattern in folded]))[:, 1 : harmonics + 1] / bins * turned
    of_means = np.array([pattern.variance_n2 / pattern.counts for pattern in folded]).sum(axis=1) / bins**2
    noise = np.sqrt(0.5 * of_means)[:, None] / width
    rows = zip(waves, noise, folded, elevator_speeds_rad_s, plate_angles_rad, strict=True)
    return [PatternWave(wave, sd, pattern.patterns, speed, angle) for wave, sd, pattern, speed, angle in rows]


def later(wave: PatternWave, turns: float) -> PatternWave:
    """The same pulses, so much of the pattern later."""
    order = np.arange(1, wave.amplitudes_n.size + 1)
    return replace(wave, amplitudes_n=wave.amplitudes_n * np.exp(-2j * np.pi * turns * order))


def residual_of_pulses(samples_n: Array, phase: Array, folded: FoldedPattern, spacings_m: Sequence[float]) -> tuple[Array, Array]:
    """Samples less the mean pattern, of which each paddle's pulse has a size, a time and a width of its own.

    Paddles are not loaded alike, a heavier load arrives for longer, and the phase creeps by tenths of a millisecond: what that
    leaves of a steep pulse is no noise. Size, time and width are those of least squares on the mean, its slope, and its slope
    times the phase from the pulse's middle, between the valleys before and after the pulse.

    Parameters
    ----------
    samples_n, phase : ndarray (n,)
        As in `fold_all`, in order.
    folded : FoldedPattern
        With a sample in every bin.
    spacings_m : sequence
        Of the paddles in the pattern.

    Returns
    -------
    ndarray (n,)
        What is left, N.
    ndarray (p,)
        How late each pulse comes that the window's ends do not cut and that is half of the mean pulse or more, in turns of the
        pattern.
    """
    mean_n, step = folded.mean_n, float(phase[-1] - phase[0]) / max(phase.size - 1, 1)
    # Over a sample's time: a sample is a mean over it, and bins that are finer only add their own noise.
    apart = max(1, round(0.5 * mean_n.size * step))
    around = np.concatenate((mean_n[-apart:], mean_n, mean_n[:apart]))
    steepness = 0.5 * mean_n.size / apart * (around[2 * apart :] - around[: -2 * apart])
    rows = np.empty((4, phase.size))
    mean, slope, wider, left = rows
    rows[:2] = _between((mean_n, steepness), phase)
    np.subtract(samples_n, mean, out=left)
    places = np.cumsum(spacings_m)
    edges = places / places[-1]
    from_valley = phase - _valley(mean_n, edges)
    turn = np.floor(from_valley)
    within = from_valley - turn
    paddle = (within >= edges[0]).astype(np.intp) if edges.size == 2 else np.searchsorted(edges[:-1], within, side="right")
    height = np.abs(mean)
    middle = np.bincount(paddle, height * within) / np.maximum(np.bincount(paddle, height), _TINY)
    np.multiply(within - middle[paddle], slope, out=wider)
    pulse = turn * edges.size + paddle
    ends = np.concatenate((_ZERO, (pulse[1:] != pulse[:-1]).nonzero()[0] + 1, (phase.size,)))
    starts, counts = ends[:-1], ends[1:] - ends[:-1]
    sizes = _sizes_of_changes(np.add.reduceat(rows[_FIRST] * rows[_SECOND], starts, axis=1))
    sizes[:, counts < _LEAST_OF_A_PULSE] = 0.0
    left = np.asarray(left - np.einsum("ij,ij->j", rows[:3], np.repeat(sizes, counts, axis=1)))
    whole = sizes[:, 1:-1]
    return left, -whole[1, whole[0] > _HALF_MISSING]


def _sizes_of_changes(products: Array) -> Array:
    """Least squares (3, p) of three changes in what is left of p pulses; 0 where they are not separated.

    products: (9, p), sums over a pulse's samples of the products of `_FIRST` and `_SECOND`.
    """
    scale = np.maximum(np.sqrt(products[:3]), _TINY)
    first, second, third = scale
    a, b, c = products[3] / (first * second), products[4] / (first * third), products[5] / (second * third)
    u, v, w = products[6:] / scale
    # Changes scaled to one make a matrix with ones on its diagonal; its inverse is symmetric.
    aa, bb, cc, of_ab, of_ac, of_bc = 1.0 - c * c, 1.0 - b * b, 1.0 - a * a, b * c - a, a * c - b, a * b - c
    determinant = aa + a * of_ab + b * of_ac
    known = determinant > _LEAST_DETERMINANT
    solved = np.array([aa * u + of_ab * v + of_ac * w, of_ab * u + bb * v + of_bc * w, of_ac * u + of_bc * v + cc * w])
    return np.where(known, solved / (np.where(known, determinant, 1.0) * scale), 0.0)


_FIRST, _SECOND = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3)]).T
"""Rows whose products the least squares want: of mean, slope, slope times phase (0 to 2), and what is left (3)."""
_ZERO = np.zeros(1, dtype=np.intp)
_TINY = 1e-150
_LEAST_DETERMINANT = 1e-6
"""Of the three changes' normal equations, each change scaled to one, below which a pulse's own are not separated."""
_HALF_MISSING = -0.5
"""Change of a pulse's size from which on there is too little of it to have a time."""
_LEAST_OF_A_PULSE = 12
"""Samples of a pulse that determine its size and time; of one cut off by the window's ends fewer may be left."""


def _between(patterns_n: Sequence[Array], phase: Array) -> Array:
    """Patterns (p, b) at phases (n,), straight between the bins' middles."""
    bins = patterns_n[0].size
    place = (phase - np.floor(phase)) * bins + 0.5
    before = place.astype(np.intp)
    part = place - before
    around = np.array([np.concatenate((pattern_n[-1:], pattern_n, pattern_n[:1])) for pattern_n in patterns_n])
    low = around.take(before, axis=1)
    return np.asarray(low + part * (around.take(before + 1, axis=1) - low))


def _valley(mean_n: Array, edges: Array) -> float:
    """The phase from which on `edges` cut the mean pattern where it is lowest."""
    bins = mean_n.size
    broad = max(1, bins // 56)
    sums = np.cumsum(np.concatenate((mean_n[-broad - 1 :], mean_n, mean_n[:broad])))
    smooth = sums[2 * broad + 1 :] - sums[: -2 * broad - 1]
    at_edges = sum(np.concatenate((smooth[cut:], smooth[:cut])) for cut in np.rint(edges * bins).astype(np.intp) % bins)
    return float(np.argmin(at_edges) + 0.5) / bins
