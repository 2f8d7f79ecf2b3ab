"""Least squares from many starts: one vectorised search, the distinct basins polished, the best one kept.

Sources: thesis chapter 9.1 (multistart least squares); Rinnooy Kan and Timmer, Mathematical Programming 39, 1987 (which starts
need no search of their own); Huber and Ronchetti, "Robust Statistics" (soft L1).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

from .calibration_problem import ROBUST_SCALE, CalibrationProblem
from .calibration_result import Basin
from .least_squares import BatchSearch, levenberg_marquardt
from .measurements import Measurements

_SAME_BASIN = 1e-3
"""Largest distance, as a share of the bounds' width, between two solutions that count as one."""
_ONE_VALLEY = 1e-2
"""The same between two unfinished searches that are one from then on."""
_MOST_BASINS = 8
_ALWAYS_SEARCHED = 20
"""Best starts that are searched whatever lies near them."""
_LINKAGE = 4.0
"""Of the critical distance in Rinnooy Kan and Timmer: above 2 the number of searches stays finite as starts are added."""


def minimize(
    problem: CalibrationProblem, starts: int, rng: np.random.Generator, progress: Callable[[float], None] | None
) -> tuple[tuple[Basin, ...], Array]:
    """Distinct minima, best first, and the parameters (n,) of the best. Raises ValueError where no start can carry the loads."""
    found, standing_for = _search(problem, _draw(problem, starts, rng), progress)
    return _basins(problem, found.theta, found.cost, standing_for)


def _draw(problem: CalibrationProblem, starts: int, rng: np.random.Generator) -> Array:
    """(starts, n): the given start, then random ones for which no load overfills a paddle."""
    first = np.clip([problem.start[n] for n in problem.names], problem.lower, problem.upper)
    low = np.clip([problem.ranges[n][0] for n in problem.names], problem.lower, problem.upper)
    high = np.clip([problem.ranges[n][1] for n in problem.names], problem.lower, problem.upper)
    theta = np.vstack((first[None], rng.uniform(low, high, (max(starts - 1, 0), len(problem.names)))))
    for _ in range(20):
        bad = ~np.all(np.isfinite(problem.momentum.value(theta)), axis=-1)
        if not np.any(bad):
            return theta
        theta[bad] = rng.uniform(low, high, (int(np.sum(bad)), len(problem.names)))
    if np.all(bad):
        raise ValueError(f"no start within the bounds can carry {_heaviest(problem.data)}; is its unit or the density wrong?")
    usable: Array = theta[~bad]
    return usable


def _heaviest(data: Measurements) -> str:
    """The heaviest load, in words, with its row."""
    _, speed_rad_s, load, _ = data.columns()
    by_flow = data.conditions.paddle_mass_kg is None
    row = int(np.argmax(load / speed_rad_s if by_flow else load))
    number = row + 1 if data.places is None else int(data.places[row]) + 1
    return f"the heaviest load, {load[row]:.4g} {'kg/s' if by_flow else 'kg a paddle'} in row {number}"


def _search(
    problem: CalibrationProblem, theta: Array, progress: Callable[[float], None] | None = None
) -> tuple[BatchSearch, NDArray[np.intp]]:
    """Batched search; each of its results with the number of starts that it stands for."""

    def residuals(t: Array, _: NDArray[np.intp]) -> tuple[Array, Array]:
        return problem.residuals(t, problem.row_sd)

    leader = _leaders(problem, theta)
    at, follows = np.unique(leader, return_inverse=True)
    near = levenberg_marquardt(
        residuals,
        theta[at],
        problem.lower,
        problem.upper,
        scale=problem.unit,
        iterations=60,
        tolerance=1e-4,
        least_gain=1e-4,
        progress=progress,
    )
    group = _groups(near.theta / problem.unit, near.cost, _ONE_VALLEY)
    best = np.array([np.flatnonzero(group == g)[np.argmin(near.cost[group == g])] for g in range(int(group.max()) + 1)])
    found = levenberg_marquardt(residuals, near.theta[best], problem.lower, problem.upper, scale=problem.unit)
    return found, np.bincount(group[follows.ravel()], minlength=best.size)


def _leaders(problem: CalibrationProblem, theta: Array) -> NDArray[np.intp]:
    """For each start the one whose search it shares: its nearest better start, and so on, where that is within reach.

    The first (the given one) and the best are always searched.
    """
    count, width = theta.shape
    leader = np.arange(count)
    if count <= _ALWAYS_SEARCHED:
        return leader
    error = (problem.momentum.value(theta)[:, problem.cell] - problem.data.momentum) / problem.row_sd
    prior = np.einsum("pn,bn->bp", problem.prior_white, theta - problem.prior_mean)
    cost = np.sum(error**2, axis=1) + np.sum(prior**2, axis=1)
    order = np.argsort(cost, kind="stable")
    reach = (_LINKAGE * scipy.special.gamma(1.0 + 0.5 * width) * np.log(count) / count) ** (1.0 / width) / np.sqrt(np.pi)
    for rank, i in enumerate(order):
        if rank < _ALWAYS_SEARCHED or i == 0:
            continue
        away = np.linalg.norm((theta[order[:rank]] - theta[i]) / problem.unit, axis=1)
        nearest = int(np.argmin(away))
        if away[nearest] < reach:
            leader[i] = leader[order[nearest]]
    return leader


def _basins(
    problem: CalibrationProblem, theta: Array, cost: Array, standing_for: NDArray[np.intp]
) -> tuple[tuple[Basin, ...], Array]:
    """Distinct minima, each polished; the best parameter vector. standing_for: starts behind each point."""
    group = _groups(theta / problem.unit, cost, _SAME_BASIN)
    inside = [np.flatnonzero(group == g) for g in range(min(int(group.max()) + 1, _MOST_BASINS))]
    best = theta[[rows[np.argmin(cost[rows])] for rows in inside]]
    polished = [
        (point, value, int(np.sum(standing_for[rows])))
        for (point, value), rows in zip(_polished(problem, best), inside, strict=True)
    ]
    merged: list[tuple[Array, float, int]] = []
    for point, value, count in sorted(polished, key=lambda item: item[1]):
        for k, (known, known_value, known_count) in enumerate(merged):
            if _one_valley(problem, point, value, known):
                merged[k] = (known, known_value, known_count + count)
                break
        else:
            merged.append((point, value, count))
    floor = max(merged[0][1], 1e-12 * problem.data.momentum.size)
    basins = tuple(Basin(tuple(map(float, point)), value / floor, count) for point, value, count in merged)
    return basins, merged[0][0]


def _one_valley(problem: CalibrationProblem, point: Array, value: float, known: Array) -> bool:
    """Whether no ridge lies between two points, or they are one point to the eye."""
    if np.max(np.abs(point - known) / problem.unit) < _SAME_BASIN:
        return True
    between = known + np.linspace(0.0, 1.0, 7)[1:-1, None] * (point - known)
    return all(problem.loss(t) <= value * (1.0 + 1e-6) for t in between)


def _polished(problem: CalibrationProblem, theta: Array) -> list[tuple[Array, float]]:
    if problem.robust:
        return [_polish_robust(problem, point) for point in theta]
    found = levenberg_marquardt(
        lambda t, _: problem.residuals(t, problem.row_sd),
        theta,
        problem.lower,
        problem.upper,
        scale=problem.unit,
        tolerance=1e-12,
    )
    return [(point, float(value)) for point, value in zip(found.theta, found.cost, strict=True)]


def _polish_robust(problem: CalibrationProblem, theta: Array) -> tuple[Array, float]:
    cache: dict[bytes, tuple[Array, Array]] = {}

    def both(t: Array) -> tuple[Array, Array]:
        key = t.tobytes()
        if key not in cache:
            cache.clear()
            r, j = problem.residuals(t[None], problem.row_sd)
            cache[key] = r[0], j[0]
        return cache[key]

    margin = 1e-12 * (problem.upper - problem.lower)
    inside = np.clip(theta, problem.lower + margin, problem.upper - margin)
    if not problem.names or not np.all(np.isfinite(both(inside)[0])):
        return theta, float(0.5 * np.sum(both(theta)[0] ** 2))

    def residuals(t: Array) -> Array:
        return np.nan_to_num(both(t)[0], nan=1e6)

    def slopes(t: Array) -> Array:
        return np.nan_to_num(both(t)[1])

    solution = scipy.optimize.least_squares(
        residuals,
        inside,
        jac=slopes,
        bounds=(problem.lower, problem.upper),
        x_scale=problem.unit,
        loss="soft_l1",
        f_scale=ROBUST_SCALE,
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
        max_nfev=200,
    )
    point = np.asarray(solution.x, dtype=float)
    # A trust-region interior method stops a hair short of a bound that the batched search sits on.
    near = np.where(
        point - problem.lower < 1e-6 * problem.unit,
        problem.lower,
        np.where(problem.upper - point < 1e-6 * problem.unit, problem.upper, point),
    )
    if problem.loss(near) <= float(solution.cost) * (1.0 + 1e-9):
        point = near
    if problem.loss(point) <= problem.loss(theta):
        return point, problem.loss(point)
    return theta, problem.loss(theta)


def _groups(place: Array, cost: Array, reach: float) -> NDArray[np.intp]:
    """Number of each point's group: points (B, n) within reach of its best, groups by ascending cost; infinite cost joins 0."""
    group = np.zeros(len(place), dtype=np.intp)
    heads: list[int] = []
    for i in np.argsort(cost, kind="stable"):
        if not np.isfinite(cost[i]):
            continue
        for number, head in enumerate(heads):
            if np.max(np.abs(place[i] - place[head]), initial=0.0) < reach:
                group[i] = number
                break
        else:
            group[i] = len(heads)
            heads.append(int(i))
    return group
