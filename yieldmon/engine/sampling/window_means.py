"""Weighted means and pulse amplitudes of windows; sums that belong to the next window are returned as a value."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.sampling import segments
from yieldmon.engine.sampling.sample_frames import SampleFrames
from yieldmon.engine.sampling.window_weights import WindowWeights
from yieldmon.physics.numerics import Array

Waves = NDArray[np.complex128]

HARMONICS = 4
"""Harmonics of the paddle pattern that make up the pulse amplitude: with two paddles a pattern, two of the paddle passes."""


@dataclass(frozen=True, slots=True)
class Leftover:
    """What the last window's samples leave to the next one. sums (4,): of weight, and of sample, speed and angle times weight.
    waves (2, HARMONICS): sums of sample times turn times weight, and of turn times weight."""

    sums: Array = field(default_factory=lambda: np.zeros(4))
    waves: Waves = field(default_factory=lambda: np.zeros((2, HARMONICS), dtype=np.complex128))


def weighted_means(
    frames: SampleFrames, weights: WindowWeights, moving: Array, before: Array
) -> tuple[Array, tuple[Array, Array, Array], Array]:
    """Total weight (w,); weighted means of sample, speed and angle, each (w,), nan without weight; sums left by the last window.

    moving (2, n): speed and angle at the middle of each frame. before: `Leftover.sums`.
    """
    samples, late = frames.samples.ravel(), weights.late
    weighted, kept = samples.copy(), np.zeros(samples.size)
    weighted[late] *= 1.0 - weights.kept
    kept[late] = weights.kept * samples[late]

    def sums(of_frames: Array, of_samples: Array) -> Array:
        rows = [
            segments.reduce(np.add, of_frames, frames.bounds, 0.0),
            segments.reduce(np.add, of_samples, frames.sample_bounds, 0.0),
            *(segments.reduce(np.add, of_frames * signal, frames.bounds, 0.0) for signal in moving),
        ]
        return np.stack(rows)

    left = sums(weights.frame_kept, kept)
    whole = sums(weights.frame_weights, weighted) + np.concatenate((before[:, None], left[:, :-1]), axis=1)
    total = whole[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean, speed, angle = whole[1:] / total
    mean[~(total > 0.0)] = np.nan
    return total, (mean, speed, angle), left[:, -1]


def pulse_harmonics(
    frames: SampleFrames, weights: WindowWeights, phase: Array, mean: Array, total: Array, before: Waves
) -> tuple[Waves, Waves]:
    """Complex amplitudes (w, HARMONICS) at the first harmonics of the paddle pattern; sums left by the last window.

    phase: of each sample (m,) along the chain. mean, total: of `weighted_means`. before: `Leftover.waves`. The mean is subtracted
    first, so that missing samples do not turn the level into an amplitude. The sums left by an earlier window are kept with and
    without the sample as a factor, because the mean is not known yet.
    """
    samples, late = frames.samples.ravel(), weights.late
    turn = _turned_back(phase)
    deviation = samples - np.repeat(np.nan_to_num(mean), np.diff(frames.sample_bounds))
    if not frames.clean:
        deviation *= frames.usable.ravel()
    deviation[late] *= 1.0 - weights.kept
    wave = np.empty(turn.size, dtype=np.complex128)
    np.multiply(deviation, turn.real, out=wave.real)
    np.multiply(deviation, turn.imag, out=wave.imag)
    bounds = frames.sample_bounds
    late_bounds = np.searchsorted(late, bounds)
    late_turn = turn[late]
    late_plain = weights.kept * late_turn
    late_wave = samples[late] * late_plain
    own = np.empty((mean.size, HARMONICS), dtype=np.complex128)
    left = np.empty((mean.size, 2, HARMONICS), dtype=np.complex128)
    for harmonic in range(HARMONICS):
        if harmonic:
            wave *= turn
            late_plain, late_wave = late_plain * late_turn, late_wave * late_turn
        own[:, harmonic] = segments.reduce(np.add, wave, bounds, 0.0)
        left[:, 0, harmonic] = segments.reduce(np.add, late_wave, late_bounds, 0.0)
        left[:, 1, harmonic] = segments.reduce(np.add, late_plain, late_bounds, 0.0)
    earlier = np.concatenate((before[None], left[:-1]))
    found = own + (earlier[:, 0] - np.nan_to_num(mean)[:, None] * earlier[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        amplitudes = np.where((total > 0.0)[:, None], 2.0 * found / total[:, None], 0.0)
    return amplitudes, left[-1]


def _turned_back(phase: Array) -> Waves:
    """exp(-2 pi i phase), by the tangent of half the angle, which costs a fraction of sine and cosine."""
    half = np.pi * phase
    np.tan(half, out=half)
    share = half * half
    share += 1.0
    np.divide(1.0, share, out=share)
    turn = np.empty(phase.size, dtype=np.complex128)
    half *= -2.0
    np.multiply(half, share, out=turn.imag)
    share *= 2.0
    np.subtract(share, 1.0, out=turn.real)
    return turn
