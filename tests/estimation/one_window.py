"""Folding and harmonics of one window, as the product has them of many, and what a mean pattern leaves of the samples."""

from __future__ import annotations

import numpy as np

from yieldmon.estimation.waveform.pattern_fold import FoldedPattern, PatternWave, fold_all, harmonics_of_all
from yieldmon.physics.numerics import Array


def fold(samples_n: Array, phase: Array) -> FoldedPattern:
    """A window's samples folded by their phase, in turns of the pattern."""
    return fold_all([samples_n], [phase])[0]


def harmonics_of(folded: FoldedPattern, harmonics: int, *, elevator_speed_rad_s: float, plate_angle_rad: float) -> PatternWave:
    """Harmonics of one pattern."""
    speeds, angles = [elevator_speed_rad_s], [plate_angle_rad]
    return harmonics_of_all([folded], harmonics, elevator_speeds_rad_s=speeds, plate_angles_rad=angles)[0]


def residual(samples_n: Array, phase: Array, folded: FoldedPattern) -> Array:
    """Samples less the mean pattern, straight between the bins' middles."""
    bins = folded.mean_n.size
    return samples_n - np.interp(phase, (np.arange(bins) + 0.5) / bins, folded.mean_n, period=1.0)
