"""Division of a sample's weight between its window and the next, by the phase of the paddle pattern.

Window k ends at the engine second t_k. Its far and near edges are ramps in chain phase p, one paddle pattern long:

    E_k(p) = clip(p - P_k + 1, 0, 1),      P_k the phase at t_k,      p = integral of chain speed dt / pattern length

and a sample's weight in window k is E_{k-1}(p) - E_k(p). The weights are causal (nothing after t_k is needed), add up to exactly
1 over the windows, and as a function of phase they are a box convolved with a box one pattern long, whose transform is zero at
every harmonic of the paddle pattern. So a steady pulse train gives a steady mean at any speed and with any spacing of the
paddles, and to first order while the speed changes. The result belongs to the time from t_{k-1} to t_k, both less half a
pattern.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from yieldmon.engine.interpolation import Knots
from yieldmon.engine.sampling.sample_frames import SampleFrames
from yieldmon.engine.sampling.segments import Counts, sum_rows
from yieldmon.physics.numerics import Array


@dataclass(frozen=True, slots=True)
class WindowWeights:
    """Weights of usable samples in their own window and in the next.

    late: those of a window's last pattern, of which the next window takes kept, both (m,); all others are wholly their own
    window's. frame_weights, frame_kept (n,): sums over each frame, of the weights in its own window and in the next.
    """

    late: Counts
    kept: Array
    frame_weights: Array
    frame_kept: Array


@dataclass(frozen=True, slots=True)
class ChainMotion:
    """Motion of the chain through w windows. phase: in paddle patterns from each window's start. weight_s (w,): whole weight of
    each window. turns (w,): the part of a pattern, 0 .. 1, that had passed at each window's start since the first window's."""

    phase: Knots
    weight_s: Array
    turns: Array

    @property
    def passed(self) -> Array:
        """Patterns that pass in each window (w,)."""
        return self.phase.values[:, -1]


class ChainPhase:
    """Motion of the chain through one window after another."""

    def __init__(self, patterns_per_rad: float, min_rate: float) -> None:
        """patterns_per_rad: paddle patterns that pass in a radian of the sprocket. min_rate: the chain counts as moving at least
        so fast, patterns/s."""
        self._patterns_per_rad = patterns_per_rad
        self._min_rate = min_rate
        self._left_s = 0.0
        self._turns = 0.0

    def take(self, speeds: Knots, edges: Array) -> ChainMotion:
        """The windows between edges (w + 1,), engine time, that follow those before."""
        rates = np.maximum(speeds.values * self._patterns_per_rad, self._min_rate)
        phases = np.zeros_like(rates)
        np.cumsum(0.5 * (rates[:, 1:] + rates[:, :-1]) * np.diff(speeds.times, axis=1), axis=1, out=phases[:, 1:])
        phase = Knots(speeds.times, phases)
        left = np.concatenate(([self._left_s], _left_to_next(phase)))
        self._left_s = float(left[-1])
        turns = []
        for passed in phases[:, -1].tolist():
            turns.append(self._turns)
            self._turns = (self._turns + passed) % 1.0
        return ChainMotion(phase, left[:-1] + np.diff(edges) - left[1:], np.array(turns))


def _left_to_next(phase: Knots) -> Array:
    """The integral of each window's far edge (w,), s: its weight left to the next window."""
    # The edge rises straight between knots.
    edge = phase.values - phase.values[:, -1:] + 1.0
    low, high = edge[:, :-1], edge[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = high * high / (high - low)
    steps_s = np.diff(phase.times, axis=1)
    parts = 0.5 * steps_s * np.where(high <= 0.0, 0.0, np.where(low >= 0.0, low + high, crossing))
    left: Array = np.cumsum(parts, axis=1)[:, -1]
    return left


def weights_of(frames: SampleFrames, to_end: Array) -> WindowWeights:
    """Weights of samples by the chain's phase. to_end (m,): phase from each of the frames' samples to its window's end, paddle
    patterns."""
    late = np.flatnonzero(to_end < 1.0)
    if not frames.clean:
        late = late[frames.usable.ravel()[late]]
    kept = np.minimum(1.0 - to_end[late], 1.0)
    count, samples = frames.usable.shape
    frame_weights = np.full(count, float(samples)) if frames.clean else sum_rows(frames.usable.astype(np.float64))
    frame_kept = np.zeros(count)
    if late.size:
        of_frame = late // samples
        begins = np.concatenate(([True], of_frame[1:] != of_frame[:-1]))
        rows = of_frame[begins]
        table = np.zeros((rows.size, samples))
        table[np.cumsum(begins) - 1, late - of_frame * samples] = kept
        frame_kept[rows] = sum_rows(table)
        frame_weights[rows] = sum_rows(frames.usable[rows] - table)
    return WindowWeights(late, kept, frame_weights, frame_kept)
