"""Test whether the model deviates from the data by more than their noise, and in which region.

Lack of fit: mean square of the whitened residuals against pure error, F(dof, dof of the noise). In the tangent plane this is the
exact distribution; a test compares it with a full nonlinear bootstrap. Region: a scan over contiguous windows of plate angle,
fill and speed, with the family-wise p value of the largest window sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

from yieldmon.estimation import model_error
from yieldmon.estimation.clusters import SAME_LOAD, cluster
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.numerics import Array, span

from .candidates import errors
from .fit import Fit
from .noise import Noise
from .observations import SAME_SPEED, Rows

DRAWS = 2000
_LEAST_DOF = 5
_MOST_EXPECTED = 1e4
"""Noncentrality from which on the power of every test is 1."""
_LEAST_BEYOND = 0.3
"""Least share of a window's change that must remain after recalibration and the windows before it."""
_LEAST_LEVEL = 0.1
"""Least level of a reading relative to the largest one, since a relative error is not meaningful near zero."""
_MOST_REGIONS, _REGION_P = 6, 0.05


@dataclass(frozen=True)
class LackOfFit:
    """F ratio of whitened residual mean square to pure error, and its p value."""

    f: float
    p_value: float


@dataclass(frozen=True)
class Region:
    """A region with an error of the model: ranges (SI, radians, fill 0..1), error (model minus measurement), family-wise p
    value."""

    plate_angle_rad: tuple[float, float]
    fill: tuple[float, float]
    elevator_speed_rad_s: tuple[float, float]
    mean_error_pct: float
    p_value: float
    cells: tuple[int, ...]


def lack_of_fit(fit: Fit, noise: Noise, *, laws: bool = True, beside: Array | None = None) -> LackOfFit:
    """Test one fit; p is 1 if there is no degree of freedom.

    F is relative to the noise alone, with the errors of the effects' laws integrated out. p also includes the model error: the
    distribution of both mean squares together is approximated by its first two moments (Satterthwaite).

    laws: whether to integrate out errors of the laws. beside: whitened columns with unit weights to integrate out instead,
    (cells, columns).
    """
    if fit.dof <= 0:
        return LackOfFit(float("nan"), 1.0)
    columns = fit.shape_error if beside is None else beside
    return _tested(fit, noise, fit.marginal(columns)[0] if laws else fit.chi2, fit.dof)


def lack_of_fit_but_one(fit: Fit, noise: Noise) -> tuple[LackOfFit, int]:
    """The test without the cell that is farthest from the fit, and that cell, since one bad reading is no missing effect.

    The fit without it is computed in the tangent plane (externally studentised residuals, Cook and Weisberg 1982). Errors of the
    effects' laws are not included.
    """
    leverage = np.sum(np.square(fit.tangent()), axis=1)
    gain = np.square(fit.residual) / np.maximum(1.0 - leverage, 1e-9)
    worst = int(np.argmax(gain))
    return _tested(fit, noise, max(fit.chi2 - float(gain[worst]), 0.0), fit.dof - 1), worst


def lack_without_pattern(fit: Fit, noise: Noise) -> LackOfFit:
    """Test for a misfit that no relative error as a function of two of angle, load and speed explains.

    Such a misfit scatters from condition to condition, which no model can explain. p is 1 if these errors explain everything.
    """
    cells = fit.frame.cells
    axes = (
        cluster(cells.plate_angle_rad, SAME_ANGLE_RAD),
        cluster(np.log(np.maximum(cells.load, 1e-9)), SAME_LOAD),
        cluster(np.log(cells.elevator_speed_rad_s), SAME_SPEED),
    )
    pairs = []
    for one, other in combinations(axes, 2):
        number = np.unique(np.stack((one, other)), axis=1, return_inverse=True)[1].ravel()
        pairs.append(np.eye(int(number.max()) + 1)[number])
    taken = model_error.orthonormal(np.concatenate(pairs, axis=1) * fit.level[:, None])
    dof = len(cells) - taken.shape[1]
    if dof < _LEAST_DOF:
        return LackOfFit(float("nan"), 1.0)
    f = float(np.sum(model_error.off(fit.residual, taken) ** 2)) / dof
    return LackOfFit(f, float(scipy.stats.f.sf(f, dof, noise.dof)))


def change_with_load(fit: Fit, noise: Noise) -> tuple[LackOfFit, float]:
    """Test for readings that do not depend on the load at each angle and speed, and its power at 1 % for readings proportional to
    the load.

    p is 1 and the power 0 if the rows have hardly more than one load there.
    """
    cells = fit.frame.cells
    axes = cluster(cells.plate_angle_rad, SAME_ANGLE_RAD), cluster(np.log(cells.elevator_speed_rad_s), SAME_SPEED)
    number = np.unique(np.stack(axes), axis=1, return_inverse=True)[1].ravel()
    dof = len(cells) - int(number.max()) - 1
    if dof < _LEAST_DOF:
        return LackOfFit(float("nan"), 1.0), 0.0
    weight = fit.frame.sd**-2.0

    def mean(values: Array) -> Array:
        return np.asarray((np.bincount(number, weight * values) / np.bincount(number, weight))[number])

    average = mean(cells.mean)
    f = float(np.sum(weight * (cells.mean - average) ** 2)) / dof
    proportional = float(np.sum(weight * (average * (cells.load / mean(cells.load) - 1.0)) ** 2))
    power = float(scipy.stats.ncf.sf(scipy.stats.f.isf(0.01, dof, noise.dof), dof, noise.dof, min(proportional, _MOST_EXPECTED)))
    return LackOfFit(f, float(scipy.stats.f.sf(f, dof, noise.dof))), power


def _tested(fit: Fit, noise: Noise, chi2: float, dof: int) -> LackOfFit:
    if dof <= 0:
        return LackOfFit(float("nan"), 1.0)
    error = model_error.off(fit.own_error, fit.tangent())
    small = error.T @ error
    extra, square = float(np.trace(small)), float(np.sum(small**2))
    mean, variance = dof + extra, 2.0 * dof + 4.0 * extra + 2.0 * square
    return LackOfFit(chi2 / dof, float(scipy.stats.f.sf(chi2 / mean, 2.0 * mean**2 / variance, noise.dof)))


def row_rms(fit: Fit, rows: Rows) -> float:
    """Root mean square of prediction minus row, in the reading's unit."""
    return float(np.sqrt(np.mean((fit.predict(rows) - rows.value) ** 2)))


def noise_floor(noise: Noise, fit: Fit, rows: Rows) -> float:
    """Root mean square of these rows with a perfect model."""
    return float(np.sqrt(np.mean(noise.of_rows(rows, fit.predict(rows)) ** 2)))


def fills(fit: Fit) -> Array:
    """Ratio of each cell's load to a full paddle, with the fitted density."""
    cells = fit.frame.cells
    machine = cells.rows.machine
    values = fit.values
    full = machine.full_paddle_mass_kg(values["density"], values["shape_ratio"])
    if cells.rows.load_name == "paddle_mass_kg":
        return cells.load / full
    passes = machine.passes_per_s(cells.elevator_speed_rad_s)
    return cells.load / passes / full


def where(fit: Fit, noise: Noise, rng: np.random.Generator) -> tuple[Region, ...]:
    """Windows in which one relative error is significant, strongest first, without overlap.

    Each window is tested together with recalibration and the windows before it, so that an error that recalibration distributes
    over other windows is not attributed to these. A window contains at most half of the cells, because recalibration adapts to
    the majority.
    """
    cells = fit.frame.cells
    fill = fills(fit)
    angles = _steps(cells.plate_angle_rad, SAME_ANGLE_RAD, 11)
    speeds = _steps(np.log(cells.elevator_speed_rad_s), SAME_SPEED, 5)
    # Effects on the paddles depend on the fill, those behind them on the flow.
    loads = [_steps(np.log(np.maximum(load, 1e-9)), SAME_LOAD, 6) for load in (fill, cells.load)]
    windows = np.unique(np.concatenate([_windows([angles, steps, speeds]) for steps in loads]), axis=0)
    tangent = fit.tangent()
    level_sd = np.abs(cells.mean) / fit.frame.sd
    changes = windows * np.maximum(level_sd, _LEAST_LEVEL * float(np.max(level_sd)))
    length = np.linalg.norm(changes, axis=1)
    changes = changes - (changes @ tangent) @ tangent.T
    norm = np.linalg.norm(changes, axis=1)
    # A window that recalibration can almost compensate is no evidence.
    keep = norm > _LEAST_BEYOND * length
    inside, changes, norm, least = windows[keep] > 0.0, changes[keep], norm[keep], _LEAST_BEYOND * length[keep]
    directions = changes / norm[:, None]
    largest = np.concatenate([np.max(np.abs(directions @ errors(fit, noise, rng, DRAWS // 4)), axis=0) for _ in range(4)])
    out: list[Region] = []
    while len(out) < _MOST_REGIONS and len(inside):
        score = (changes @ fit.residual) / norm
        best = int(np.argmax(np.abs(score)))
        # The random draws are for the first window; those for a later one would not be larger.
        p = float((1 + np.count_nonzero(largest >= abs(score[best]))) / (1 + len(largest)))
        if p > _REGION_P:
            break
        out.append(_region(fit, inside[best], fill, p))
        found = changes[best] / norm[best]
        changes = changes - np.outer(changes @ found, found)
        norm = np.linalg.norm(changes, axis=1)
        keep = (norm > least) & ~np.any(inside & inside[best], axis=1)
        inside, changes, norm, least = inside[keep], changes[keep], norm[keep], least[keep]
    return tuple(out)


def _region(fit: Fit, inside: NDArray[np.bool_], fill: Array, p_value: float) -> Region:
    cells = fit.frame.cells
    error = float(np.mean(fit.residual[inside]))
    mean = float(np.mean(cells.mean[inside] / fit.frame.sd[inside]))
    largest_ratio = float(np.max(np.abs(cells.mean / fit.frame.sd)))
    return Region(
        span(cells.plate_angle_rad[inside]),
        span(fill[inside]),
        span(cells.elevator_speed_rad_s[inside]),
        100.0 * error / (mean if abs(mean) > 1.0 else largest_ratio),
        p_value,
        tuple(int(j) for j in np.flatnonzero(inside)),
    )


def _steps(values: Array, width: float, most: int) -> NDArray[np.int64]:
    numbers = cluster(values, width)
    if numbers.max() < most:
        return numbers
    edges = np.quantile(values, np.linspace(0.0, 1.0, most + 1)[1:-1])
    return np.asarray(np.searchsorted(edges, values, side="right"), dtype=np.int64)


def _windows(axes: list[NDArray[np.int64]]) -> Array:
    """Indicator of each distinct window with at least 2 and at most half of the cells, shape (windows, cells)."""
    spans = []
    for numbers in axes:
        count = int(numbers.max()) + 1
        intervals = [(i, j) for i, j in combinations(range(count + 1), 2)]
        spans.append(np.array([(numbers >= i) & (numbers < j) for i, j in intervals]))
    inside = spans[0][:, None, None, :] & spans[1][None, :, None, :] & spans[2][None, None, :, :]
    flat = inside.reshape(-1, inside.shape[-1])
    total = flat.sum(axis=1)
    flat = flat[(total >= 2) & (2 * total <= flat.shape[1])]
    return np.unique(flat, axis=0).astype(float)
