"""Scatter of the grain of one crop between machines, estimated from all machines (empirical Bayes)."""

from __future__ import annotations

import numpy as np

from yieldmon.physics.numerics import Array

GRAIN_SD = 0.1
"""Prior scale of the scatter of grain between machines, in units of relevant steps (`physics.grain`)."""
_GRID = np.concatenate(([0.0], np.geomspace(0.01, 4.0, 40)))
_SWEEPS = 3


def grain_scatter(information: Array, score: Array) -> Array:
    """Posterior means of the variances of grain between machines, (parameters,), estimated one parameter after the other.

    information: of each machine on its grain, (machines, parameters, parameters). score: (machines, parameters).
    """
    count = score.shape[-1]
    variance = np.full(count, GRAIN_SD**2)
    sd = GRAIN_SD * _GRID
    prior = np.exp(-0.5 * _GRID**2) * np.gradient(sd)
    for _ in range(_SWEEPS):
        for k in range(count):
            tried = np.tile(np.sqrt(variance), (sd.size, 1))
            tried[:, k] = sd
            scaled = tried[:, None, :] * score
            small = np.eye(count) + tried[:, None, :, None] * information * tried[:, None, None, :]
            fitted = np.sum(scaled * np.linalg.solve(small, scaled[..., None])[..., 0], axis=-1)
            likely = 0.5 * np.sum(fitted - np.linalg.slogdet(small)[1], axis=-1)
            weight = np.exp(likely - likely.max()) * prior
            variance[k] = float(np.sum(weight * sd**2) / np.sum(weight))
    return variance
