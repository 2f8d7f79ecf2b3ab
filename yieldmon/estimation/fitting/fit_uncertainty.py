"""What a fit leaves unknown: covariance of its parameters, standard errors, and what the model's own error adds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from yieldmon.estimation import model_error
from yieldmon.physics.numerics import Array

from .calibration_problem import CalibrationProblem, Noise
from .calibration_result import CONFIDENCE
from .scatter_law import LEAST_PURE_DOF

_CLOSE = 0.05
"""Share of the width between bounds within which a value counts as at one of them."""
_LEFT_OUT = 2.0
"""Of what the fit leaves: more than that of an angle or load left out, which shows half of something or less, is the spread of
parameters that the others hardly determine, and none of the model's error."""
_HALVINGS = 40
"""Of the interval in which the bounds' share is looked for."""


@dataclass(frozen=True, slots=True)
class FitUncertainty:
    """covariance: (n, n), no parameter less certain than anywhere between its bounds, the model's own error included.
    standard_errors: (n,) by the data and the prior alone; inf where they do not fix a parameter. correlation: (n, n) of these.
    stretch: (n,) of the standard errors over those of rows that scatter alike. model_error: relative size of the model's own
    error; None where it is not known."""

    covariance: Array
    standard_errors: Array
    correlation: Array
    stretch: Array
    model_error: float | None


def fit_uncertainty(
    problem: CalibrationProblem, theta: Array, predicted: Array, slopes: Array, cell_slopes: Array, noise: Noise
) -> FitUncertainty:
    """Uncertainty of the best fit. theta (n,); predicted (rows,), slopes (rows, n), cell_slopes (cells, n): the model there."""
    weighted = slopes * noise.weight[:, None]
    factor = max(noise.variance_factor, 1e-300)
    information = weighted.T @ weighted / factor
    information = information + problem.prior_white.T @ problem.prior_white
    # What rows that scatter more or less than the fit takes them for add to the information's variance (Huber, 1967).
    unlike = None if noise.spread is None else weighted.T @ (weighted * (noise.spread - 1.0)[:, None]) / factor
    alike, singular = _inverse(information, problem.unit)
    free = _spread_out(alike, unlike)
    # In the file a parameter is never less certain than anywhere between its bounds, and few rows show their noise less well.
    most = distance_within(problem.lower, problem.upper, theta)
    unsure = problem.unsure_of(noise)
    if unsure > 1.0:
        information = weighted.T @ weighted / (unsure * factor) + problem.prior_white.T @ problem.prior_white
    inverse = _bounded_inverse(information, most) if np.any(singular) else _inverse(information, problem.unit)[0]
    covariance = _spread_out(inverse, unlike)
    size = _estimated_error(problem, predicted - problem.data.momentum, cell_slopes, noise, problem.bound_sides(theta) == 0)
    if size is not None:
        covariance = _with_model_error(problem, covariance, inverse, size, predicted, weighted, noise)
    covariance = _within(covariance, most)
    deviation = np.sqrt(np.diag(free))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = free / np.outer(deviation, deviation)
        stretch = np.where(np.diag(alike) > 0.0, deviation / np.sqrt(np.diag(alike)), 1.0)
    standard_errors = np.where(singular, np.inf, np.sqrt(np.maximum(np.diag(free), 0.0)))
    return FitUncertainty(covariance, standard_errors, correlation, stretch, size)


def distance_within(lower: Array, upper: Array, at: Array) -> Array:
    """Standard deviation of a value that may lie anywhere between the bounds; about `at` where that is at a bound, or close."""
    width = upper - lower
    about = np.sqrt(((upper - at) ** 3 + (at - lower) ** 3) / (3.0 * width))
    inside = np.minimum(at - lower, upper - at) > _CLOSE * width
    return np.asarray(np.where(inside, width / np.sqrt(12.0), about))


def _spread_out(inverse: Array, unlike: Array | None) -> Array:
    """Covariance of a fit whose inverse information this is, where rows scatter unlike."""
    if unlike is None:
        return inverse
    out = inverse + inverse @ unlike @ inverse
    return np.asarray(0.5 * (out + out.T))


def wald_intervals(problem: CalibrationProblem, theta: Array, standard_errors: Array, dof: float) -> Array:
    """(n, 2): ends of the CONFIDENCE intervals by standard errors (n,) alone, within the bounds."""
    reach = scipy.special.stdtrit(dof, 0.5 + 0.5 * CONFIDENCE) * np.where(np.isfinite(standard_errors), standard_errors, np.inf)
    return np.stack((np.maximum(theta - reach, problem.lower), np.minimum(theta + reach, problem.upper)), axis=-1)


def _with_model_error(
    problem: CalibrationProblem,
    covariance: Array,
    inverse: Array,
    size: float,
    predicted: Array,
    weighted: Array,
    noise: Noise,
) -> Array:
    """covariance: by noise. inverse: of the information, by which the fit follows an error."""
    angle, speed, load, _ = problem.data.columns()
    # A constant error is absorbed by the impact gain: it is none of the forces', but one of what they are made of.
    shapes = np.column_stack((model_error.basis(angle, load, speed), np.ones(load.size)))
    own = size * shapes * (model_error.level(predicted) * noise.weight)[:, None]
    moved = inverse @ (weighted.T / max(noise.variance_factor, 1e-300) @ own)
    return np.asarray(covariance + moved @ moved.T)


def _estimated_error(
    problem: CalibrationProblem, error: Array, slopes: Array, fitted: Noise, inside: NDArray[np.bool_]
) -> float | None:
    """Relative size of the model's own error, from angles and loads left out; None where it is not known.

    error: of each row. slopes: of each cell. fitted: the rows' noise as the fit took it; outliers of a robust fit say as
    little of the model as they did there. inside: (n,) parameters at no bound: one at a bound makes up for no error.
    Where neither replicates nor a stated sigma part it from noise, what no smooth error makes of the residuals is noise; the
    error is at most _LEFT_OUT times what the fit leaves. With too few rows for that all that it leaves is taken for noise where
    angles and loads are left out, and the error is no larger than that.
    """
    if not slopes.shape[1]:
        return None
    share = (fitted.weight * problem.row_sd) ** 2 if problem.robust else np.ones(error.size)
    count = np.bincount(problem.cell, share)
    first = np.unique(problem.cell, return_index=True)[1]
    angle, speed, load, _ = problem.data.columns()[:, first]
    mean = np.bincount(problem.cell, share * error) / count
    predicted = np.bincount(problem.cell, share * (error + problem.data.momentum)) / count
    if not np.any(predicted):
        return None  # No grain reaches the plate: there is nothing that an error could be relative to.
    level = model_error.level(predicted)
    parted = problem.pure_dof >= LEAST_PURE_DOF or problem.given_sigma
    smooth = model_error.basis(angle, load, speed) * level[:, None]
    unexplained = 0.0 if parted else _unexplained_sd(problem, mean, np.column_stack((slopes * problem.unit, smooth)), count)
    least = 1e-9 * float(np.max(np.abs(predicted)))
    row_sd = np.maximum(fitted.row_sd, least)
    if problem.given_sigma:
        noise = np.bincount(problem.cell, share * problem.row_sd**-2.0) ** -0.5
    elif parted or unexplained > 0.0:
        noise = np.maximum(problem.pure_sd if parted else unexplained, least) / np.sqrt(count)
    else:
        noise = np.bincount(problem.cell, row_sd**-2.0) ** -0.5
    if problem.spread is not None:
        noise = noise * np.sqrt(problem.spread[first])
    known_noise = parted or unexplained > 0.0
    following = slopes[:, inside] if known_noise else slopes
    basis = model_error.orthonormal(following / noise[:, None] * (problem.unit[inside] if known_noise else problem.unit))
    residual = mean / noise
    if problem.spread is not None or unexplained > 0.0:
        # As a fit leaves it that weighs the cells by their noise.
        residual = residual - basis @ (basis.T @ residual)
    size = model_error.estimated(residual, basis, noise / level, model_error.groups_of(angle, load))
    if size is None:
        return None
    if known_noise:
        dof = max(count.size - basis.shape[1], 1)
        most = _LEFT_OUT * float(np.sqrt(np.sum(residual**2) / dof / np.mean((level / noise) ** 2)))
        return max(min(size, most), model_error.FLOOR)
    most = float(np.mean((level[problem.cell] / row_sd) ** 2)) ** -0.5
    return min(size, most) if min(size, most) > model_error.FLOOR else None


def _unexplained_sd(problem: CalibrationProblem, mean: Array, columns: Array, count: Array | NDArray[np.int64]) -> float:
    """Standard deviation of a row by what is left of the cells' mean errors beside these columns, and by replicates; 0 where
    fewer than LEAST_PURE_DOF degrees of freedom are left. The mean of its inverse square is right."""
    root = np.sqrt(count)
    explained = model_error.orthonormal(columns * root[:, None])
    dof = count.size - explained.shape[1] + problem.pure_dof
    if dof < LEAST_PURE_DOF:
        return 0.0
    within = problem.pure_dof * problem.pure_sd**2 if problem.pure_dof else 0.0
    return float(np.sqrt((np.sum(model_error.off(mean * root, explained) ** 2) + within) / (dof - 2)))


def _inverse(information: Array, unit: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Inverse of an information matrix, and which parameters take part in a direction that it leaves free."""
    if not information.size:
        return np.zeros((0, 0)), np.zeros(0, dtype=bool)
    scaled = information * unit[:, None] * unit[None, :]
    size = np.sqrt(np.maximum(np.diag(scaled), 1e-300))
    values, vectors = np.linalg.eigh(scaled / np.outer(size, size))
    free = values <= 1e-13 * max(float(values[-1]), 1e-300)
    inverse = np.where(free, 0.0, 1.0 / np.where(free, 1.0, values))
    covariance = (vectors * inverse) @ vectors.T / np.outer(size, size) * unit[:, None] * unit[None, :]
    loose = np.any(np.abs(vectors[:, free]) > 1e-3, axis=1) | (np.diag(scaled) <= 0.0)
    return 0.5 * (covariance + covariance.T), loose


def _bounded_inverse(information: Array, sd: Array) -> Array:
    """Covariance where the information leaves directions free: in those, that of anywhere between the bounds, sd (n,).

    The information of rows without noise is so large that the bounds' own, added to it, would be lost in rounding.
    """
    values, vectors = np.linalg.eigh(information * np.outer(sd, sd))
    values = np.where(values <= 1e-13 * max(float(values[-1]), 0.0), 0.0, values)
    covariance = (vectors / (1.0 + values)) @ vectors.T * np.outer(sd, sd)
    return np.asarray(0.5 * (covariance + covariance.T))


def _within(covariance: Array, sd: Array) -> Array:
    """The covariance with as much of the bounds' own information, sd (n,), added as keeps each variance within sd^2.

    No more than that: the best fit is not drawn towards the middle, and its error is that of the rows. What the rows determine
    together, such as the flow, stays as well known as it is, which scaling of single parameters would not leave.
    """
    if np.all(np.diag(covariance) <= sd**2):
        return covariance
    values, vectors = np.linalg.eigh(covariance / np.outer(sd, sd))
    values = np.maximum(values, 0.0)
    least, share = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (least + share)
        enough = np.max(vectors**2 @ (values / (1.0 + middle * values))) <= 1.0
        least, share = (least, middle) if enough else (middle, share)
    covariance = (vectors * (values / (1.0 + share * values))) @ vectors.T * np.outer(sd, sd)
    return np.asarray(0.5 * (covariance + covariance.T))
