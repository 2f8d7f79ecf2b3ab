"""Bounded least squares from many starts at once, by Levenberg and Marquardt.

Every iteration evaluates all unfinished starts in one vectorised pass. Method: Marquardt, J. SIAM 11 (1963), for the scaling;
bounds by projection with an active set (Bertsekas, SIAM J. Control Optim. 20, 1982).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

Residuals = Callable[[Array, NDArray[np.intp]], tuple[Array, Array]]
"""(theta (B, n), indices of the starts (B,)) -> residuals (B, m) and their derivatives (B, m, n); nan where impossible."""


@dataclass(frozen=True, slots=True)
class BatchSearch:
    """theta: (B, n); cost: (B,) half the sum of squares; converged: (B,); residuals and derivatives there."""

    theta: Array
    cost: Array
    converged: NDArray[np.bool_]
    residual: Array
    jacobian: Array


def levenberg_marquardt(
    residuals: Residuals,
    start: Array,
    lower: Array,
    upper: Array,
    *,
    held: NDArray[np.bool_] | None = None,
    scale: Array | None = None,
    iterations: int = 120,
    tolerance: float = 1e-9,
    least_gain: float = 0.0,
    learns_curvature: bool = False,
    progress: Callable[[float], None] | None = None,
) -> BatchSearch:
    """Minimise half the sum of squares from every start at once, within bounds.

    Parameters
    ----------
    residuals
        See `Residuals`.
    start
        (B, n), inside the bounds. One where residuals are nan has cost inf and does not move.
    lower, upper
        (n,) or (B, n).
    held
        (B, n), parameters that keep their start value.
    scale
        (n,), the size in which steps count as small; default: upper - lower.
    iterations
        Most steps that a start takes, rejected ones included.
    tolerance
        A start has arrived when no parameter moves by more than this share of its scale, or
    least_gain
        when the next step promises to lower the sum of squares by less than this times 1 + its mean square; 0: never for that
        reason.
    learns_curvature
        Take the curvature of the residuals into account, as the derivatives' changes from step to step show it: fewer steps where
        residuals stay large (Dennis, Gay and Welsch, ACM TOMS 7, 1981; symmetric rank-one updates).
    progress
        Called with the share of starts that are done.
    """
    theta = np.array(start, dtype=float)
    count = len(theta)
    low, high = np.broadcast_to(lower, theta.shape), np.broadcast_to(upper, theta.shape)
    unit = np.broadcast_to(high - low if scale is None else scale, theta.shape)
    fixed = np.zeros(theta.shape, dtype=bool) if held is None else held
    residual, jacobian = (np.array(part) for part in residuals(theta, np.arange(count)))
    cost, size = _cost(residual), max(residual.shape[-1], 1)
    damping = np.full(count, 1e-3)
    done = ~np.isfinite(cost)
    converged = np.zeros(count, dtype=bool)
    curvature = np.zeros((count, theta.shape[-1], theta.shape[-1]))
    for _ in range(iterations):
        at = np.flatnonzero(~done)
        if progress is not None:
            progress(1.0 - at.size / count)
        if not at.size:
            break
        gradient = np.einsum("bmn,bm->bn", jacobian[at], residual[at]) * unit[at]
        normal = np.einsum("bmi,bmj->bij", jacobian[at], jacobian[at]) * unit[at, :, None] * unit[at, None, :]
        if learns_curvature:
            normal = _curved(normal, curvature[at])
        frozen = fixed[at] | ((theta[at] <= low[at]) & (gradient > 0.0)) | ((theta[at] >= high[at]) & (gradient < 0.0))
        step = _damped_step(normal, gradient, frozen, damping[at])
        trial = np.clip(theta[at] + step * unit[at], low[at], high[at])
        if least_gain > 0.0:
            move = (trial - theta[at]) / unit[at]
            expected = -2.0 * np.sum(gradient * move, axis=-1) - np.einsum("bi,bij,bj->b", move, normal, move)
            # A step cut short by a bound promises less than a shorter one might.
            cut = np.any(trial != theta[at] + step * unit[at], axis=-1) & (damping[at] < 1e3)
            worth = cut | (expected >= least_gain * (1.0 + 2.0 * cost[at] / size))
            done[at[~worth]] = converged[at[~worth]] = True
            at, trial = at[worth], trial[worth]
            if not at.size:
                continue
        trial_residual, trial_jacobian = residuals(trial, at)
        trial_cost = _cost(trial_residual)
        moved = np.max(np.abs(trial - theta[at]) / unit[at], axis=-1, initial=0.0)
        better = trial_cost <= cost[at]
        if learns_curvature:
            there = np.where(better[:, None], trial_residual, residual[at])
            bent = np.einsum("bmn,bm->bn", trial_jacobian - jacobian[at], there) * unit[at]
            curvature[at] = _learnt(curvature[at], (trial - theta[at]) / unit[at], bent)
        stalled = moved <= tolerance
        taken = at[better]
        theta[taken], cost[taken] = trial[better], trial_cost[better]
        residual[taken], jacobian[taken] = trial_residual[better], trial_jacobian[better]
        light = damping[at] <= (1e-3 if learns_curvature else -1.0)
        damping[at] = np.where(better, np.maximum(damping[at] * 0.1, 1e-12), damping[at] * 8.0)
        # A short step by heavy damping is a stall; one nearly undamped has arrived.
        arrived = stalled & (better | light | (damping[at] > 1e8))
        converged[at] |= arrived
        done[at] |= arrived | (damping[at] > 1e12)
    return BatchSearch(theta, cost, converged, residual, jacobian)


def _curved(normal: Array, curvature: Array) -> Array:
    """(B, n, n): the second derivatives of half the sum of squares, without the residuals' own where both together would have
    directions without an end."""
    both = normal + curvature
    least = np.linalg.eigvalsh(both)[:, 0]
    plain = np.linalg.eigvalsh(normal)[:, 0]
    return np.where((least > 0.1 * plain)[:, None, None], both, normal)


def _learnt(curvature: Array, step: Array, change: Array) -> Array:
    """(B, n, n): the symmetric rank-one update after which curvature @ step is `change`; none where that is ill determined."""
    missing = change - np.einsum("bij,bj->bi", curvature, step)
    along = np.einsum("bi,bi->b", missing, step)
    size = np.linalg.norm(missing, axis=-1) * np.linalg.norm(step, axis=-1)
    sure = np.isfinite(size) & (np.abs(along) > 1e-8 * size)
    missing, along = np.where(sure[:, None], missing, 0.0), np.where(sure, along, 1.0)
    return np.asarray(curvature + missing[:, :, None] * missing[:, None, :] / along[:, None, None])


def _cost(residual: Array) -> Array:
    with np.errstate(over="ignore"):
        total = 0.5 * np.sum(residual * residual, axis=-1)
    return np.where(np.isfinite(total), total, np.inf)


def _damped_step(normal: Array, gradient: Array, frozen: NDArray[np.bool_], damping: Array) -> Array:
    width = gradient.shape[-1]
    eye = np.eye(width, dtype=bool)
    free = ~frozen
    matrix = np.where(free[:, :, None] & free[:, None, :], normal, 0.0)
    diagonal = np.einsum("bii->bi", matrix)
    floor = 1e-15 * np.max(diagonal, axis=-1, keepdims=True, initial=0.0) + 1e-300
    added = np.where(free, damping[:, None] * np.maximum(diagonal, floor), 1.0)
    matrix = matrix + np.where(eye, added[:, :, None], 0.0)
    # Scaled to a unit diagonal: densities beside frictions leave the solver nothing to lose.
    size = np.sqrt(np.einsum("bii->bi", matrix))
    matrix = matrix / (size[:, :, None] * size[:, None, :])
    step: Array = -np.linalg.solve(matrix, (np.where(free, gradient, 0.0) / size)[..., None])[..., 0] / size
    return step
