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
    track_curvature: bool = False,
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
    track_curvature
        Take the curvature of the residuals into account, as the derivatives' changes from step to step show it: fewer steps where
        residuals stay large (Dennis, Gay and Welsch, ACM TOMS 7, 1981; symmetric rank-one updates).
    progress
        Called with the share of starts that are done.
    """
    search = _Search(
        residuals, start, lower, upper, held=held, scale=scale, tolerance=tolerance, least_gain=least_gain,
        track_curvature=track_curvature,
    )  # fmt: skip
    for _ in range(iterations):
        going = np.flatnonzero(~search.done)
        if progress is not None:
            progress(1.0 - going.size / len(search.done))
        if not going.size:
            break
        search.advance(going)
    return search.found()


class _Search:
    """Where each start has come to (B, ...), and whether it is done."""

    def __init__(
        self,
        residuals: Residuals,
        start: Array,
        lower: Array,
        upper: Array,
        *,
        held: NDArray[np.bool_] | None,
        scale: Array | None,
        tolerance: float,
        least_gain: float,
        track_curvature: bool,
    ) -> None:
        self._residuals = residuals
        self._tolerance, self._least_gain, self._track_curvature = tolerance, least_gain, track_curvature
        self._theta = np.array(start, dtype=float)
        count, width = self._theta.shape
        self._low, self._high = np.broadcast_to(lower, self._theta.shape), np.broadcast_to(upper, self._theta.shape)
        self._unit = np.broadcast_to(self._high - self._low if scale is None else scale, self._theta.shape)
        self._held = np.zeros(self._theta.shape, dtype=bool) if held is None else held
        self._residual, self._jacobian = (np.array(part) for part in residuals(self._theta, np.arange(count)))
        self._cost = _cost(self._residual)
        self._damping = np.full(count, 1e-3)
        self._curvature = np.zeros((count, width, width))
        self._converged = np.zeros(count, dtype=bool)
        self.done: NDArray[np.bool_] = ~np.isfinite(self._cost)

    def found(self) -> BatchSearch:
        """What was reached."""
        return BatchSearch(self._theta, self._cost, self._converged, self._residual, self._jacobian)

    def advance(self, at: NDArray[np.intp]) -> None:
        """One step, taken or rejected, of the starts `at`."""
        jacobian, residual, unit = self._jacobian[at], self._residual[at], self._unit[at]
        gradient = np.einsum("bmn,bm->bn", jacobian, residual) * unit
        normal = np.einsum("bmi,bmj->bij", jacobian, jacobian) * unit[:, :, None] * unit[:, None, :]
        if self._track_curvature:
            normal = _curved(normal, self._curvature[at])
        theta, low, high = self._theta[at], self._low[at], self._high[at]
        frozen = self._held[at] | ((theta <= low) & (gradient > 0.0)) | ((theta >= high) & (gradient < 0.0))
        wanted = theta + _damped_step(normal, gradient, frozen, self._damping[at]) * unit
        trial = np.clip(wanted, low, high)
        if self._least_gain > 0.0:
            # A step cut short by a bound promises less than a shorter one might.
            cut = np.any(trial != wanted, axis=-1) & (self._damping[at] < 1e3)
            worth = cut | self._promises(at, (trial - theta) / unit, gradient, normal)
            self.done[at[~worth]] = self._converged[at[~worth]] = True
            at, trial = at[worth], trial[worth]
        if at.size:
            self._take(at, trial)

    def _promises(self, at: NDArray[np.intp], move: Array, gradient: Array, normal: Array) -> NDArray[np.bool_]:
        """Whether a move, in units, lowers the sum of squares by enough, as the quadratic model has it."""
        expected = -2.0 * np.sum(gradient * move, axis=-1) - np.einsum("bi,bij,bj->b", move, normal, move)
        size = max(self._residual.shape[-1], 1)
        return np.asarray(expected >= self._least_gain * (1.0 + 2.0 * self._cost[at] / size))

    def _take(self, at: NDArray[np.intp], trial: Array) -> None:
        """Evaluate the trial places, go to those that are better, and set damping and what is done by the outcome."""
        residual, jacobian = self._residuals(trial, at)
        cost = _cost(residual)
        move = (trial - self._theta[at]) / self._unit[at]
        better = cost <= self._cost[at]
        if self._track_curvature:
            there = np.where(better[:, None], residual, self._residual[at])
            bent = np.einsum("bmn,bm->bn", jacobian - self._jacobian[at], there) * self._unit[at]
            self._curvature[at] = _rank_one_update(self._curvature[at], move, bent)
        taken = at[better]
        self._theta[taken], self._cost[taken] = trial[better], cost[better]
        self._residual[taken], self._jacobian[taken] = residual[better], jacobian[better]
        light = self._damping[at] <= (1e-3 if self._track_curvature else -1.0)
        self._damping[at] = np.where(better, np.maximum(self._damping[at] * 0.1, 1e-12), self._damping[at] * 8.0)
        stalled = np.max(np.abs(move), axis=-1, initial=0.0) <= self._tolerance
        # A short step by heavy damping is a stall; one nearly undamped has arrived.
        arrived = stalled & (better | light | (self._damping[at] > 1e8))
        self._converged[at] |= arrived
        self.done[at] |= arrived | (self._damping[at] > 1e12)


def _curved(normal: Array, curvature: Array) -> Array:
    """(B, n, n): the second derivatives of half the sum of squares, without the residuals' own where both together would have
    directions without an end."""
    both = normal + curvature
    least = np.linalg.eigvalsh(both)[:, 0]
    plain = np.linalg.eigvalsh(normal)[:, 0]
    return np.where((least > 0.1 * plain)[:, None, None], both, normal)


def _rank_one_update(curvature: Array, step: Array, change: Array) -> Array:
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
