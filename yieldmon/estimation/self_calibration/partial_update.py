"""Restriction of an update to what the data determine.

Parameters whose standard deviation hardly decreases keep value and variance, and their error still counts in the others'
(Schmidt, "Application of state-space methods to navigation problems", 1966).
"""

from __future__ import annotations

import numpy as np

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.priors import Prior
from yieldmon.physics.numerics import Array


def determined_part(
    prior: Prior, theta: Array, information: Array, lower: Array, upper: Array, settings: ClosedLoopSettings
) -> tuple[Array, Array]:
    """Mean and covariance of the parameters after an update along the determined directions only.

    Parameters
    ----------
    prior : Prior
    theta : ndarray (n,)
        Most likely parameters.
    information : ndarray (n, n)
        Of the data alone.
    lower, upper : ndarray (n,)
        Limits of the parameters.
    settings : ClosedLoopSettings
        `learned_information` and `kept_ratio` are used.

    Returns
    -------
    ndarray (n,), ndarray (n, n)
        Those of the prior if the data determine nothing.
    """
    white, _ = prior.whitening(prior.names)
    root = np.linalg.inv(white)
    values, vectors = np.linalg.eigh(root.T @ information @ root)
    values = np.maximum(values, 0.0)
    used = values >= settings.learned_information
    if not np.any(used):
        return prior.mean, prior.covariance
    kept = vectors[:, used]
    # In whitened coordinates the prior covariance is 1, and the eigenvalues are the information of the data.
    step = root @ kept @ (kept.T @ (white @ (theta - prior.mean)))
    gain = root @ kept @ np.diag(values[used] / (1.0 + values[used])) @ kept.T @ white
    joint = root @ (np.eye(theta.size) - kept @ np.diag(values[used] / (1.0 + values[used])) @ kept.T) @ root.T
    shrunk = np.sqrt(np.diag(joint)) / prior.standard_deviation < settings.kept_ratio
    if not np.any(shrunk):
        return prior.mean, prior.covariance
    # Schmidt: kept parameters have no gain, and their error stays in that of the others.
    gain = np.where(shrunk[:, None], gain, 0.0)
    noise = joint @ (white.T @ kept @ np.diag(values[used]) @ kept.T @ white) @ joint
    left = np.eye(theta.size) - gain
    covariance = left @ prior.covariance @ left.T + np.where(np.outer(shrunk, shrunk), noise, 0.0)
    covariance = 0.5 * (covariance + covariance.T)
    mean = np.where(shrunk, prior.mean + step, prior.mean)
    still = np.outer(~shrunk, ~shrunk)
    # theta lies within the limits, but the used part of its step may end slightly beyond them.
    return np.clip(mean, lower, upper), np.where(still, prior.covariance, covariance)
