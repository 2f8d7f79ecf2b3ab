"""Profile likelihood: the misfit as one parameter is moved and all others are fitted again.

Sources: Venzon and Moolgavkar, Applied Statistics 37, 1988 (intervals); Bates and Watts, "Nonlinear Regression Analysis and Its
Applications", chapter 6 (curves).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

from .calibration_problem import CalibrationProblem, Noise
from .calibration_result import CONFIDENCE, FittedParameter, ProfileCurve
from .fit_uncertainty import FitUncertainty, fit_uncertainty
from .least_squares import levenberg_marquardt

_ROUNDS = 14
"""Fits for each end of an interval, at most."""
_NEAR_ENOUGH = 0.01
"""Relative distance of the rise at an end from the limit."""


def intervals(problem: CalibrationProblem, theta: Array, uncertainty: FitUncertainty, noise: Noise) -> Array:
    """(n, 2): where the best fit over the other parameters gets worse by the F quantile; a bound where it never does.

    theta (n,) and uncertainty: of the best fit. The quantile is stretched as the standard errors are.
    """
    standard_errors = uncertainty.standard_errors
    width = theta.size
    sign = np.tile([-1.0, 1.0], width)
    index = np.repeat(np.arange(width), 2)
    row_sd, limit = noise.row_sd, _limit(noise.dof) * uncertainty.stretch[index]
    reach = _limit(noise.dof) * np.where(np.isfinite(standard_errors[index]), standard_errors[index], np.inf)
    size = np.clip(np.where(np.isfinite(standard_errors), standard_errors, problem.unit), 1e-12 * problem.unit, problem.unit)
    best = float(np.sum(problem.residuals(theta[None], row_sd)[0] ** 2))
    room = np.where(sign < 0.0, theta[index] - problem.lower[index], problem.upper[index] - theta[index])
    ends = _Ends(room, reach, limit)
    held = index[:, None] == np.arange(width)
    current = np.tile(theta, (2 * width, 1))
    for _ in range(_ROUNDS):
        at = ends.unfinished
        if not at.size:
            break
        trial = current[at].copy()
        trial[np.arange(at.size), index[at]] = (theta[index] + sign * ends.place)[at]
        found = levenberg_marquardt(
            lambda t, _: problem.residuals(t, row_sd),
            trial,
            problem.lower,
            problem.upper,
            held=held[at],
            scale=size,
            iterations=25,
            tolerance=1e-4,
        )
        current[at] = np.where(np.isfinite(found.cost)[:, None], found.theta, current[at])
        for i, rise in zip(at, np.sqrt(np.maximum(2.0 * found.cost - best, 0.0)), strict=True):
            ends.take(int(i), float(rise))
    out = theta[index] + sign * ends.place
    out = np.where(ends.open, np.where(sign < 0.0, problem.lower[index], problem.upper[index]), out)
    return out.reshape(width, 2)


def _limit(dof: float) -> float:
    """Rise at the ends of the CONFIDENCE interval: the root of the F quantile."""
    return float(np.sqrt(scipy.special.fdtri(1, dof, CONFIDENCE)))


class _Ends:
    """Root searches side by side: the distances (m,) from the best fit at which the misfit has risen to the limits (m,).

    room: distances to the bounds; an end that gets there without rising that far is open. first: distances to begin with.
    """

    def __init__(self, room: Array, first: Array, limit: Array) -> None:
        self.place = np.minimum(first, room)
        self.open: NDArray[np.bool_] = room <= 0.0
        self._room, self._limit = room, limit
        self._done = self.open.copy()
        # The farthest place known to lie below the limit and the nearest above it, with their rises.
        self._near, self._near_rise = np.zeros(room.size), np.zeros(room.size)
        self._far, self._far_rise = self.place.copy(), np.full(room.size, np.nan)

    @property
    def unfinished(self) -> NDArray[np.intp]:
        """Ends that need another fit, at `place`."""
        return np.flatnonzero(~self._done)

    def take(self, i: int, rise: float) -> None:
        """The rise at the place of end i; inf where the model cannot carry the loads there."""
        if rise < self._limit[i]:
            self._near[i], self._near_rise[i] = self.place[i], rise
            if self.place[i] >= self._room[i] * (1.0 - 1e-12):
                self.open[i] = self._done[i] = True
                return
        else:
            self._far[i], self._far_rise[i] = self.place[i], rise
        if abs(rise - self._limit[i]) < _NEAR_ENOUGH * self._limit[i]:
            self._done[i] = True
        else:
            self.place[i] = self._next(i)

    def _next(self, i: int) -> float:
        near, rise = self._near[i], self._near_rise[i]
        if np.isnan(self._far_rise[i]):
            ratio = self._limit[i] / max(rise, 0.1 * self._limit[i])
            return float(min(max(near * ratio * 1.05, near + 1e-9 * self._room[i]), self._room[i]))
        if np.isfinite(self._far_rise[i]):
            share = (self._limit[i] - rise) / max(self._far_rise[i] - rise, 1e-300)
            return float(near + np.clip(share, 0.05, 0.95) * (self._far[i] - near))
        return float(0.5 * (near + self._far[i]))


def curves(problem: CalibrationProblem, fitted: Sequence[FittedParameter], points: int) -> tuple[ProfileCurve, ...]:
    """Profile of each parameter at `points` values, out to 1.6 times its interval or to a bound."""
    theta = np.array([p.value for p in fitted])
    width = theta.size
    value, jacobian = problem.momentum(theta[None])
    predicted, slopes = value[0][problem.cell], jacobian[0][problem.cell]
    noise = problem.noise(predicted - problem.data.momentum, slopes)
    stretch = fit_uncertainty(problem, theta, predicted, slopes, jacobian[0], noise).stretch
    row_sd, limit = noise.row_sd, _limit(noise.dof)
    grids = [_span(problem, p, points) for p in fitted]
    start = np.tile(theta, (width * points, 1))
    index = np.repeat(np.arange(width), points)
    start[np.arange(index.size), index] = np.concatenate(grids)
    held = index[:, None] == np.arange(width)
    found = levenberg_marquardt(
        lambda t, _: problem.residuals(t, row_sd),
        start,
        problem.lower,
        problem.upper,
        held=held,
        iterations=60,
        tolerance=1e-5,
    )
    best = float(np.sum(problem.residuals(theta[None], row_sd)[0] ** 2))
    rise = np.sqrt(np.maximum(2.0 * found.cost - best, 0.0)).reshape(width, points)
    return tuple(
        ProfileCurve(p.name, grid, np.where(np.isfinite(line), np.copysign(line, grid - p.value), np.nan), limit * own)
        for p, grid, line, own in zip(fitted, grids, rise, stretch.tolist(), strict=True)
    )


def _span(problem: CalibrationProblem, parameter: FittedParameter, points: int) -> Array:
    """Ascending, with the fitted value among them where it lies inside."""
    i = problem.names.index(parameter.name)
    low, high = (parameter.value + 1.6 * (end - parameter.value) for end in parameter.interval)
    low, high = max(low, problem.lower[i]), min(high, problem.upper[i])
    half = points // 2
    if low < parameter.value < high:
        return np.concatenate(
            (np.linspace(low, parameter.value, half, endpoint=False), np.linspace(parameter.value, high, points - half))
        )
    return np.linspace(low, high, points)
