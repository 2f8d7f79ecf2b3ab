"""Samples that stay at one value for longer than pulses of grain can: of a sensor or converter that hung for part of a second."""

from __future__ import annotations

import numpy as np

from yieldmon.engine.sampling import segments
from yieldmon.engine.sampling.sample_frames import SampleFrames
from yieldmon.physics.numerics import Array

LEAST_S = 0.25
"""Least time at one value: paddles come every 0.06 to 0.14 s."""
_LEAST, _LOOKS = 20, 4
"""Least number of samples in that time; and how often it is looked at for equal values before all samples are compared."""


def frozen(frames: SampleFrames, interval_s: float) -> tuple[Array, Array]:
    """How long the samples of each window (w,) stayed at one value, s, and that value, mV; both 0 below `LEAST_S`.

    Parameters
    ----------
    frames : SampleFrames
    interval_s : float
        Between samples.

    Returns
    -------
    tuple
        Of the longest such time in each window; 0 where samples of it are not usable.
    """
    values, bounds = frames.samples.ravel(), frames.sample_bounds
    held_s, held_mv = np.zeros(bounds.size - 1), np.zeros(bounds.size - 1)
    stride = int(LEAST_S / interval_s) // _LOOKS
    if stride * _LOOKS < _LEAST or not values.size:
        return held_s, held_mv
    looks = bounds[:-1, None] + stride * np.arange(int(np.diff(bounds).max()) // stride + 1)
    within = looks < bounds[1:, None]
    seen = values[np.minimum(looks, values.size - 1)]
    same = (seen[:, 1:] == seen[:, :-1]) & within[:, 1:]
    in_a_row = same[:, 2:] & same[:, 1:-1] & same[:, :-2]
    suspects = in_a_row.any(axis=1)
    if not frames.clean:
        suspects &= segments.count(~frames.usable.ravel(), bounds) == 0
    for window in np.flatnonzero(suspects).tolist():
        own = values[bounds[window] : bounds[window + 1]]
        edges = np.concatenate(([0], np.flatnonzero(own[1:] != own[:-1]) + 1, [own.size]))
        lengths = np.diff(edges)
        longest = int(lengths.argmax())
        if lengths[longest] * interval_s >= LEAST_S:
            held_s[window], held_mv[window] = lengths[longest] * interval_s, own[edges[longest]]
    return held_s, held_mv
