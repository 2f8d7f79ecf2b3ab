"""A calibration as a least-squares problem: weighted residuals of rows about the model, within bounds, beside a prior."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yieldmon.arguments import require_type
from yieldmon.estimation.model_error import orthonormal
from yieldmon.estimation.priors import Bounds, Prior, fitting_bounds, follows_scale, start_ranges
from yieldmon.physics.grain import GRAIN
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

from .batch import MomentumBatch
from .measurements import Measurements
from .scatter_law import LEAST_PURE_DOF, OUTLIER_SDS, either_form, fit_variances, medians, scattering, usual_deviation

ROBUST_SCALE = 1.5
"""Residuals beyond this many noise standard deviations lose weight (soft L1)."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of the rows as the best fit's residuals show it.

    weight: (rows,) of the fit: 1 over the standard deviation, less for outliers of a robust fit. variance_factor: what the
    variances are multiplied by. dof: degrees of freedom that this rests on. spread: as of `CalibrationProblem`.
    """

    weight: Array
    variance_factor: float
    dof: float
    spread: Array | None

    @property
    def row_sd(self) -> Array:
        """(rows,) standard deviations."""
        return np.asarray(np.sqrt(max(self.variance_factor, 1e-300)) / self.weight)


def conditions_told_apart(model: ForwardModel, data: Measurements) -> int:
    """How many conditions the rows have that the model tells apart: as many parameters can they determine at most."""
    at = data.conditions
    if not model.needs_moisture:
        at = replace(at, moisture_pct=None)
    _, cell = replace(data, conditions=at).cells()
    return int(cell.max()) + 1


def _refuse(
    model: ForwardModel,
    data: Measurements,
    start: Mapping[str, float],
    names: tuple[str, ...],
    bounds: Bounds,
    *,
    with_prior: bool,
) -> None:
    """Raises ValueError for a calibration that has no answer."""
    require_type("model", model, ForwardModel, "a ForwardModel")
    require_type("data", data, Measurements, "Measurements")
    require_type("start", start, Mapping, "values by name, such as the `values` of a ParameterSet")
    if data.momentum.size < len(names) and not with_prior:
        raise ValueError(f"{data.momentum.size} rows cannot fix {len(names)} parameters ({', '.join(names)})")
    missing = [n for n in names if n not in start]
    if missing:
        raise ValueError(f"free parameters {missing} are not among {list(start)}")
    if len(set(names)) < len(names):
        raise ValueError(f"free parameters {list(names)}: expected each once")
    for name, (low, high) in bounds.items():
        if not low < high:
            raise ValueError(f"bounds of {name} ({low:g}, {high:g}): expected the lower one first")
        if name not in start and name not in GRAIN:
            raise ValueError(f"bounds of {name}: not in this model; expected one of {', '.join(start)}")
    if not np.any(data.momentum):
        raise ValueError("measurements: every reading is 0; expected readings of grain")


class CalibrationProblem:
    """Rows, their weights, the free parameters, their bounds and prior.

    Attributes
    ----------
    names : tuple of str
        The free parameters.
    lower, upper, unit : ndarray (n,)
        Their bounds, and a typical distance for each.
    ranges : mapping
        For each, the two values between which searches start.
    cell : ndarray (rows,)
        For each row the number of its own among the distinct conditions.
    row_sd : ndarray (rows,)
        Standard deviation of each row: given, else estimated.
    prior_white, prior_mean : ndarray (p, n), (n,)
        Whitening of the prior and its mean; p is 0 without a prior.
    pure_sd, pure_dof : float, int
        Standard deviation within replicates and its degrees of freedom; nan and 0 without any.
    spread : ndarray (rows,) or None
        Variance of each row over row_sd^2, mean 1 over the replicates, where these scatter more at high readings than at low
        ones; None where they do not show it. The fit weighs rows alike all the same; errors and tests allow for it.
    """

    def __init__(
        self,
        model: ForwardModel,
        data: Measurements,
        start: Mapping[str, float],
        names: tuple[str, ...],
        *,
        prior: Prior | None,
        bounds: Bounds | None,
        robust: bool,
    ) -> None:
        _refuse(model, data, start, names, bounds or {}, with_prior=prior is not None)
        self.model, self.data, self.names, self.robust = model, data, names, robust
        self.start, self._prior, self._bounds = dict(start), prior, bounds
        cells, self.cell = data.cells()
        self.momentum = MomentumBatch(model, cells, names, {k: v for k, v in start.items() if k not in names})
        self.scale = data_scale(model, data) if any(follows_scale(n) for n in names) else 1.0
        limits = fitting_bounds(names, self.scale, bounds)
        self.lower = np.array([min(limits[n]) for n in names])
        self.upper = np.array([max(limits[n]) for n in names])
        self.ranges = start_ranges(names, self.scale)
        self.pure_sd, self.pure_dof = self._pure_error()
        self.given_sigma = data.sigma is not None
        self.row_sd = data.sigma if data.sigma is not None else np.full(data.momentum.shape, self._first_noise())
        self.spread = self._spread()
        self.prior_white, self.prior_mean = (
            prior.restricted(names).whitening(names) if prior is not None else (np.zeros((0, len(names))), np.zeros(len(names)))
        )
        self.unit = np.array([self._unit(n, lo, hi) for n, lo, hi in zip(names, self.lower, self.upper, strict=True)])

    def of(self, data: Measurements) -> CalibrationProblem:
        """The same question asked of other rows."""
        return CalibrationProblem(
            self.model, data, self.start, self.names, prior=self._prior, bounds=self._bounds, robust=self.robust
        )

    def _unit(self, name: str, low: float, high: float) -> float:
        first, last = self.ranges[name]
        return min(high - low, max(last - first, 1e-9 * (high - low)))

    def _pure_error(self) -> tuple[float, int]:
        """Standard deviation of a row within its cell and its degrees of freedom; by medians where the fit is robust."""
        counts = np.bincount(self.cell)
        dof = int(np.sum(counts - 1))
        if dof < 1:
            return float("nan"), 0
        if not self.robust:
            return self.scatter(), dof
        y = self.data.momentum
        middle = medians(y, self.cell)
        repeated = counts[self.cell] > 1
        spread = np.abs(y - middle[self.cell]) * np.sqrt(np.count_nonzero(repeated) / dof)
        scatters = repeated & scattering(y, self.cell)
        return usual_deviation(spread[scatters if scatters.any() else repeated]), dof

    def _spread(self) -> Array | None:
        if self.given_sigma or self.pure_dof < LEAST_PURE_DOF or not self.pure_sd > 0.0:
            return None
        y = self.data.momentum
        middle = medians(y, self.cell)
        repeated = np.bincount(self.cell)[self.cell] > 1
        relative = np.abs(y - middle[self.cell]) / either_form(middle)[self.cell]
        scatters = repeated & scattering(y, self.cell)
        usual = usual_deviation(relative[scatters if scatters.any() else repeated])
        good = repeated & (relative <= OUTLIER_SDS * np.sqrt(2.0) * usual) if usual > 0.0 else repeated
        count = np.bincount(self.cell[good], minlength=middle.size)
        mean = np.bincount(self.cell[good], y[good], minlength=middle.size) / np.maximum(count, 1)
        square = np.bincount(self.cell[good], (y - mean[self.cell])[good] ** 2, minlength=middle.size)
        some = count > 1
        dof = (count[some] - 1).astype(float)
        if dof.sum() < LEAST_PURE_DOF or not square.sum() > 0.0:
            return None
        constant, proportional = fit_variances(square[some] / dof, dof, mean[some] ** 2, float(square.sum() / dof.sum()))
        if proportional == 0.0:
            return None
        law = constant + proportional * middle**2
        freedom = np.bincount(self.cell) - 1.0
        return np.asarray((law * freedom.sum() / float(freedom @ law))[self.cell])

    def bound_sides(self, theta: Array) -> NDArray[np.int64]:
        """For each free parameter at (n,) the bound that it is at, -1 for the lower and 1 for the upper one, else 0."""
        at_lower, at_upper = theta <= self.lower + 1e-9 * self.unit, theta >= self.upper - 1e-9 * self.unit
        return np.where(at_lower, -1, at_upper.astype(np.int64))

    @property
    def shows_noise(self) -> bool:
        """Whether a fit leaves residuals: there is more than one value for each parameter."""
        return self.data.momentum.size + len(self.prior_white) > len(self.names)

    def unsure_of(self, noise: Noise) -> float:
        """By what the rows' variance is larger, 1 or more, once what is usual counts for the degrees of freedom that few rows
        lack: residuals of one or two may be next to nothing by chance."""
        lacking = LEAST_PURE_DOF - (self.data.momentum.size + len(self.prior_white) - len(self.names))
        if self.given_sigma or lacking <= 0:
            return 1.0
        begun_with = float(np.mean((self._usual_noise() / noise.row_sd) ** 2))
        return max(1.0, 1.0 + (min(lacking, LEAST_PURE_DOF) / LEAST_PURE_DOF) * (begun_with - 1.0))

    def scatter(self) -> float:
        """Standard deviation of a row about the mean of its cell, in the momentum's unit; nan without replicates."""
        y, counts = self.data.momentum, np.bincount(self.cell)
        dof = int(np.sum(counts - 1))
        means = np.bincount(self.cell, y) / counts
        return float(np.sqrt(np.sum((y - means[self.cell]) ** 2) / dof)) if dof > 0 else float("nan")

    def _first_noise(self) -> float:
        if np.isfinite(self.pure_sd) and self.pure_sd > 1e-7 * self._usual_noise():
            return self.pure_sd
        return self._usual_noise()

    def _usual_noise(self) -> float:
        """Of readings of which nothing else is known."""
        return 0.01 * float(np.max(np.abs(self.data.momentum)))

    def residuals(self, theta: Array, row_sd: Array) -> tuple[Array, Array]:
        """Weighted residuals (B, rows + prior) and derivatives."""
        value, jacobian = self.momentum(theta)
        r = (value[:, self.cell] - self.data.momentum) / row_sd
        j = jacobian[:, self.cell] / row_sd[:, None]
        if not len(self.prior_white):
            return r, j
        extra = np.einsum("pn,bn->bp", self.prior_white, theta - self.prior_mean)
        slopes = np.broadcast_to(self.prior_white, (len(theta), *self.prior_white.shape))
        return np.concatenate((r, extra), axis=1), np.concatenate((j, slopes), axis=1)

    def loss(self, theta: Array) -> float:
        """Half the sum of squares at (n,), by soft L1 where the fit is robust; inf where the model cannot carry the loads."""
        r = self.residuals(theta[None], self.row_sd)[0][0]
        z = r * r
        if self.robust:
            z = 2.0 * ROBUST_SCALE**2 * (np.sqrt(1.0 + z / ROBUST_SCALE**2) - 1.0)
        total = 0.5 * float(np.sum(z))
        return total if np.isfinite(total) else float("inf")

    def noise(self, error: Array, slopes: Array) -> Noise:
        """The rows' noise, from the residuals (rows,) of the best fit and the derivatives (rows, n) there."""
        weight = 1.0 / self.row_sd
        if self.robust:
            weight = weight * (1.0 + (error * weight / ROBUST_SCALE) ** 2) ** -0.25
        dof = max(error.size - len(self.names) + len(self.prior_white), 1)
        inflation = float(np.sum((error * weight) ** 2) / dof)
        if self.spread is not None:
            mean, share = residual_moments(slopes * weight[:, None] * self.unit, self.spread)
            return Noise(weight, inflation / mean, max(share * dof, 1.0), self.spread)
        # A given sigma counts unless the residuals say it is too small (Birge's ratio); so does what was begun with where a fit
        # through every row leaves none.
        begun_with = self.given_sigma or not self.shows_noise
        return Noise(weight, max(inflation, 1.0) if begun_with else inflation, dof, None)


def residual_moments(slopes: Array, variance: Array) -> tuple[float, float]:
    """Of the sum of squares that least squares with derivatives (n, p) leaves of rows of these variances (n,): its mean for each
    degree of freedom, and the share of these that a chi-square of the same mean and variance has (Satterthwaite, 1946)."""
    tangent = orthonormal(slopes)
    free = max(variance.size - tangent.shape[1], 1)
    leverage = np.sum(tangent**2, axis=1)
    inner = tangent.T @ (tangent * variance[:, None])
    first = float(np.sum((1.0 - leverage) * variance))
    second = float(np.sum((1.0 - 2.0 * leverage) * variance**2) + np.sum(inner**2))
    if not (first > 0.0 and second > 0.0):
        return 1.0, 1.0
    return first / free, min(first**2 / (second * free), 1.0)


def data_scale(model: ForwardModel, data: Measurements) -> float:
    """Units of the data in one kg m/s, roughly: their median over that of a middling grain (impact gain 1.5)."""
    # Dense enough that heavy loads fit on the paddles.
    values = {p.name: p.typical for p in GRAIN.values() if p.form in ("", "restitution")} | {"density": 1500.0}
    plain = model.with_effects(()).paddle_momentum(data.cells()[0], values, overfull="nan")
    middle = float(np.nanmedian(np.real(plain)))
    return float(np.median(data.momentum)) / middle if middle > 0.0 and np.median(data.momentum) > 0.0 else 1.0
