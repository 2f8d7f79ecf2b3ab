"""Samples clipped at a plateau below the end of the range, by an amplifier or a converter."""

from __future__ import annotations

import numpy as np

from yieldmon.engine.sampling import segments
from yieldmon.engine.sampling.sample_frames import SampleFrames
from yieldmon.engine.sampling.segments import Counts
from yieldmon.physics.numerics import Array

_LEAST_SHARE, _LEAST = 0.02, 12
"""Least share and least number of a window's samples at the largest value."""
_TIMES = 6.0
"""Least ratio to the number at the next lower value. The crest of a quantised parabola has at most 2.4, 1 / (sqrt(2) - 1)."""
_LEAST_LEVELS = 8
"""Least number of distinct values in a window; with fewer, the quantisation is too coarse to tell a crest."""
_LEAST_PULSES = 3
"""Least number of clipped crests."""


def cut_off(frames: SampleFrames) -> tuple[Counts, Array]:
    """How many samples of each window (w,) lie at a ceiling, and its value, mV; both 0 where there is none.

    Parameters
    ----------
    frames : SampleFrames

    Returns
    -------
    tuple
        Pulses of grain have one crest each, of which a sample or two come near the largest; several crests that all end at the
        same value, much more often met than the next one below, are cut off.
    """
    values, bounds = frames.samples.ravel(), frames.sample_bounds
    counts, ceiling = np.zeros(bounds.size - 1, np.intp), np.zeros(bounds.size - 1)
    if not frames.clean or not values.size:
        return counts, ceiling
    samples = np.diff(bounds)
    high = segments.reduce(np.maximum, values, bounds, -np.inf)
    at_top = segments.count(values == np.repeat(high, samples), bounds)
    suspects = np.flatnonzero((at_top >= _LEAST) & (at_top >= _LEAST_SHARE * samples))
    for window in suspects.tolist():
        own = values[bounds[window] : bounds[window + 1]]
        levels, times = np.unique(own, return_counts=True)
        top = own == levels[-1]
        crests = int(np.count_nonzero(top[1:] & ~top[:-1])) + int(top[0])
        if levels.size >= _LEAST_LEVELS and times[-1] >= _TIMES * times[-2] and crests >= _LEAST_PULSES:
            counts[window], ceiling[window] = times[-1], levels[-1]
    return counts, ceiling
