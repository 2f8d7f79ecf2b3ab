"""An update of which only what the data determine is taken.

Parameters whose width hardly shrinks keep value and variance, and their error goes on counting in the others' (Schmidt,
"Application of state-space methods to navigation problems", 1966).
"""

from __future__ import annotations

import numpy as np

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.priors import Prior
from yieldmon.physics.numerics import Array


def determined_part(
    prior: Prior, theta: Array, information: Array, lower: Array, upper: Array, settings: ClosedLoopSettings
) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) after leaving out what the data do not determine; the prior's own where nothing was.

    theta: (n,) likeliest parameters, between lower and upper. information: (n, n) of the data alone. settings:
    learned_information and kept_ratio.
    """
    white, _ = prior.whitening(prior.names)
    root = np.linalg.inv(white)
    values, vectors = np.linalg.eigh(root.T @ information @ root)
    values = np.maximum(values, 0.0)
    used = values >= settings.learned_information
    if not np.any(used):
        return prior.mean, prior.covariance
    kept = vectors[:, used]
    # Whitened: prior covariance 1, so data information is the eigenvalues.
    step = root @ kept @ (kept.T @ (white @ (theta - prior.mean)))
    gain = root @ kept @ np.diag(values[used] / (1.0 + values[used])) @ kept.T @ white
    joint = root @ (np.eye(theta.size) - kept @ np.diag(values[used] / (1.0 + values[used])) @ kept.T) @ root.T
    shrunk = np.sqrt(np.diag(joint)) / prior.standard_deviation < settings.kept_ratio
    if not np.any(shrunk):
        return prior.mean, prior.covariance
    # Schmidt: the kept parameters have no gain of their own, and their error stays in that of the others.
    gain = np.where(shrunk[:, None], gain, 0.0)
    noise = joint @ (white.T @ kept @ np.diag(values[used]) @ kept.T @ white) @ joint
    left = np.eye(theta.size) - gain
    covariance = left @ prior.covariance @ left.T + np.where(np.outer(shrunk, shrunk), noise, 0.0)
    covariance = 0.5 * (covariance + covariance.T)
    mean = np.where(shrunk, prior.mean + step, prior.mean)
    still = np.outer(~shrunk, ~shrunk)
    # The search kept theta within the physical bounds; the part of its step that is used may end a little beyond them.
    return np.clip(mean, lower, upper), np.where(still, prior.covariance, covariance)
