"""Variation of the flow during a sweep, estimated from windows at the same plate angle.

Differences between windows at one angle contain window noise and the flow's variation, but neither the model's error nor errors
of the grain's parameters, which are the same in both windows. The variation is an Ornstein-Uhlenbeck process with a known
correlation time. Its size is estimated from the restricted likelihood (Patterson and Thompson, Biometrika 58, 1971; one mean for
each angle) and a prior.
"""

from __future__ import annotations

import numpy as np

from yieldmon.estimation.clusters import cluster
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.numerics import Array

_LOG_PRIOR_SD = 1.0
_GRID = np.exp(np.linspace(-3.0, 3.0, 121))


def correlation(time_s: Array, time_constant_s: float) -> Array:
    """exp(-|lag| / time_constant_s), shape (n, n)."""
    return np.asarray(np.exp(-np.abs(time_s[:, None] - time_s) / time_constant_s))


def process_sd(
    log_flow: Array, log_flow_sd: Array, plate_angle_rad: Array, time_s: Array, time_constant_s: float, prior_sd: float
) -> float:
    """Relative standard deviation of the flow's variation: root of the posterior mean of its variance.

    Parameters
    ----------
    log_flow, log_flow_sd : ndarray (n,)
        ln(flow) of each window with any parameters, and its standard deviation by noise. An offset common to the windows of one
        angle has no effect.
    plate_angle_rad, time_s : ndarray (n,)
    time_constant_s : float
        Correlation time.
    prior_sd : float
        Most likely value before the sweep, uncertain by a factor e (log-normal).

    Returns
    -------
    float
        prior_sd if no angle was visited twice or prior_sd is 0.
    """
    contrasts = _contrasts(plate_angle_rad)
    if prior_sd == 0.0 or not len(contrasts):
        return prior_sd
    noise = (contrasts * log_flow_sd**2) @ contrasts.T
    wander = contrasts @ correlation(time_s, time_constant_s) @ contrasts.T
    # noise = V^-T V^-1 and wander = V^-T diag(share) V^-1: both diagonal in the same coordinates.
    from scipy import linalg

    share, vectors = linalg.eigh(wander, noise)
    squares = (vectors.T @ (contrasts @ log_flow)) ** 2
    candidates = prior_sd * _GRID
    variance = 1.0 + candidates[:, None] ** 2 * np.maximum(share, 0.0)
    score = np.sum(np.log(variance) + squares / variance, axis=1) + (np.log(_GRID) / _LOG_PRIOR_SD) ** 2
    weight = np.exp(-0.5 * (score - score.min()))
    return float(np.sqrt(np.sum(weight * candidates**2) / np.sum(weight)))


def _contrasts(plate_angle_rad: Array) -> Array:
    """Orthonormal contrasts between windows of the same angle, (n - angles, n)."""
    order = np.argsort(plate_angle_rad, kind="stable")
    starts = np.flatnonzero(np.diff(cluster(plate_angle_rad, SAME_ANGLE_RAD)[order])) + 1
    rows = []
    for group in np.split(order, starts):
        for k in range(1, group.size):
            # Helmert contrast: the k-th window against the mean of those before it.
            row = np.zeros(plate_angle_rad.size)
            row[group[:k]] = -1.0 / k
            row[group[k]] = 1.0
            rows.append(row / np.sqrt(1.0 + 1.0 / k))
    return np.array(rows).reshape(-1, plate_angle_rad.size)
