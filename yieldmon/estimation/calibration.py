"""System calibration: grain and effect parameters from rows of known load and measured momentum.

Many starts are searched in one vectorised pass, the distinct basins polished, the best one kept and examined: standard
errors, profile-likelihood intervals, correlations, bounds, replicates. Sources: thesis chapter 9.1 (multistart least squares);
Rinnooy Kan and Timmer, Mathematical Programming 39, 1987 (which starts need no search of their own);
Draper and Smith, "Applied Regression Analysis" (pure error and lack of fit); Venzon and Moolgavkar, Applied Statistics 37, 1988
(profile intervals); Huber and Ronchetti, "Robust Statistics".
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, fdtri, gamma, stdtrit

from yieldmon.physics.effects import effect_parameter
from yieldmon.physics.grain import GRAIN
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from . import model_error
from .batch import MomentumBatch
from .least_squares import BatchSearch, levenberg_marquardt
from .model_error import orthonormal
from .parameters import CalibratedRange, ParameterSet
from .priors import Bounds, Prior, at_bound_sentence, fitting_bounds, follows_scale, start_ranges, stretch

CONFIDENCE = 0.95
_ROBUST_SCALE = 1.5
"""Residuals beyond this many noise standard deviations lose weight (soft L1)."""
_OUTLIER = 5.0
"""Residual, in robust standard deviations, from which a row is named as an outlier."""
_LEAST_PURE_DOF = 8
"""Degrees of freedom of the replicates from which they separate noise from the model's own error."""
_SAME_BASIN = 1e-3
"""Largest distance, as a share of the bounds' width, between two solutions that count as one."""
_ONE_VALLEY = 1e-2
"""The same between two unfinished searches that are one from then on."""
_MOST_BASINS = 8
_ALWAYS_SEARCHED = 20
"""Best starts that are searched whatever lies near them."""
_LINKAGE = 4.0
"""Of the critical distance in Rinnooy Kan and Timmer: above 2 the number of searches stays finite as starts are added."""


@dataclass(frozen=True)
class Measurements:
    """Rows of known load: conditions (1-D arrays), momentum (n,) per paddle in kg m/s or a response's own unit.

    sigma: (n,) standard deviation of each momentum, None where unknown; then it is estimated from the rows. places: (n,) index of
    each row in the table that it comes from, None where these are all of its rows. Rows with a momentum or load that is nan do
    not belong here. Raises ValueError for them.
    """

    conditions: Conditions
    momentum: Array
    sigma: Array | None = None
    places: NDArray[np.intp] | None = None

    def __post_init__(self) -> None:
        if self.momentum.ndim != 1 or not np.all(np.isfinite(self.momentum)):
            raise ValueError("measurements: momentum must be one row of finite numbers")
        if self.sigma is not None and not (self.sigma.shape == self.momentum.shape and np.all(self.sigma > 0.0)):
            raise ValueError("measurements: sigma must hold a number above 0 for each row")
        if not np.all(np.isfinite(self._all()[[0, 1, 2, 4]])):
            raise ValueError("measurements: angle, speed, load and plate position must be finite")

    def columns(self) -> Array:
        """(4, n): plate angle, elevator speed, load, moisture (nan where unknown)."""
        c = self.conditions
        load = c.mass_flow_kg_s if c.paddle_mass_kg is None else c.paddle_mass_kg
        moisture = np.nan if c.moisture_pct is None else c.moisture_pct
        parts = [np.asarray(v, dtype=float) for v in (c.plate_angle_rad, c.elevator_speed_rad_s, load, moisture)]
        return np.stack([np.broadcast_to(part, self.momentum.shape) for part in parts])

    def select(self, rows: NDArray[np.bool_]) -> Measurements:
        """Those rows alone."""
        places = np.flatnonzero(rows) if self.places is None else self.places[rows]
        return Measurements(
            self._conditions(self._all()[:, rows]),
            self.momentum[rows],
            None if self.sigma is None else self.sigma[rows],
            places,
        )

    def cells(self) -> tuple[Conditions, NDArray[np.intp]]:
        """The distinct conditions, and for each row the index of its own."""
        columns = np.nan_to_num(self._all(), nan=-1.0)
        distinct, index = np.unique(columns, axis=1, return_inverse=True)
        distinct = np.where((np.arange(5)[:, None] == 3) & (distinct < 0.0), np.nan, distinct)
        return self._conditions(distinct), index.ravel()

    def _all(self) -> Array:
        """(5, n): the columns, and the plate's position (0 where it is not given)."""
        position = 0.0 if self.conditions.plate_position_m is None else np.asarray(self.conditions.plate_position_m, dtype=float)
        return np.vstack((self.columns(), np.broadcast_to(position, self.momentum.shape)[None]))

    def _conditions(self, columns: Array) -> Conditions:
        angle, speed, load, moisture, position = columns
        by_flow = self.conditions.paddle_mass_kg is None
        known = None if self.conditions.moisture_pct is None else moisture
        place = None if self.conditions.plate_position_m is None else position
        return Conditions(angle, speed, load if by_flow else None, None if by_flow else load, known, place)


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """One free parameter. interval: profile likelihood, CONFIDENCE; an end at a bound is open: the data do not limit it."""

    name: str
    value: float
    standard_error: float
    """inf where the data do not fix it."""
    interval: tuple[float, float]
    open_below: bool
    open_above: bool
    at_bound: str
    """"lower", "upper" or ""."""

    @property
    def determined(self) -> bool:
        """Whether the data limit it on both sides."""
        return not (self.open_below or self.open_above or self.at_bound or not np.isfinite(self.standard_error))


@dataclass(frozen=True, slots=True)
class Basin:
    """One distinct minimum: values in the order of the free names, half the sum of squares over that of the best, starts."""

    values: tuple[float, ...]
    relative_cost: float
    starts: int


@dataclass(frozen=True, slots=True)
class Residuals:
    """Quality of the fit. rms in the momentum's unit; pure error and lack of fit from replicates, nan where there are none."""

    rows: int
    rms: float
    rms_over_max_pct: float
    noise_sd: float
    """Standard deviation of one row that errors and intervals are based on; 1 where the rows' own sigma was given."""
    pure_error_sd: float
    pure_error_dof: int
    lack_of_fit_f: float
    lack_of_fit_p: float
    outlier_rows: tuple[int, ...]
    """Indices in the table."""


@dataclass(frozen=True)
class Calibration:
    """The result of `calibrate`. correlation: (n, n) in the order of `parameters`."""

    parameter_set: ParameterSet
    parameters: tuple[FittedParameter, ...]
    correlation: Array
    basins: tuple[Basin, ...]
    starts: int
    residuals: Residuals
    predicted: Array = field(repr=False)
    """(rows,), in the order of the measurements."""
    jacobian: Array = field(repr=False)
    """(rows, n): derivatives of the predictions."""
    sentences: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters."""
        return tuple(p.name for p in self.parameters)


def calibrate(
    model: ForwardModel,
    data: Measurements,
    start: Mapping[str, float],
    free: Sequence[str],
    *,
    prior: Prior | None = None,
    bounds: Bounds | None = None,
    starts: int = 20,
    rng: np.random.Generator | None = None,
    robust: bool = False,
    intervals: bool = True,
    response_unit: str = "N",
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Least squares of momentum over the `free` parameters, from `start` and `starts` - 1 random places.

    start: values of all parameters of the model (those not free keep theirs). bounds override the published or physical ones.
    robust: soft-L1 loss. Raises ValueError when there are fewer rows than free parameters or the model cannot carry the loads.
    """
    problem = _Problem(model, data, start, tuple(free), prior, bounds, robust)
    rng = np.random.default_rng(0) if rng is None else rng
    found, standing_for = problem.search(problem.draw(starts, rng), progress)
    basins, theta = problem.polish(found.theta, found.cost, standing_for)
    return problem.result(theta, basins, starts, response_unit, intervals)


@dataclass(frozen=True)
class ProfileCurve:
    """Misfit against one parameter, every other free one refitted at each point.

    values: ascending, (points,). rise: root of the growth of chi-square over the best fit, (points,), negative below the best
    value; a straight line where the model is linear, flat where the data say nothing, nan where the model cannot carry the loads.
    limit: the rise at the ends of the CONFIDENCE interval.
    """

    name: str
    values: Array
    rise: Array
    limit: float


def profile_curves(
    model: ForwardModel,
    data: Measurements,
    fitted: Calibration,
    *,
    prior: Prior | None = None,
    bounds: Bounds | None = None,
    robust: bool = False,
    points: int = 25,
) -> tuple[ProfileCurve, ...]:
    """Profile of every free parameter, out to 1.6 times its interval or to a bound (Bates and Watts, chapter 6).

    prior, bounds, robust: as in the call of `calibrate` that gave `fitted`.
    """
    problem = _Problem(model, data, fitted.parameter_set.values, fitted.names, prior, bounds, robust)
    return problem.curves(fitted, points)


def default_start(
    model: ForwardModel, data: Measurements, impact: Sequence[str], known: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Values to start from: the given ones, else middling grain and effects at their typical size, in the data's scale."""
    known = dict(known or {})
    scale = data_scale(model, data) if any(GRAIN[name].follows_response for name in impact) else 1.0
    chosen = (*(p.name for p in GRAIN.values() if not p.form), *impact)
    values = {name: GRAIN[name].typical * stretch(name, scale) for name in chosen}
    for name in model.effect_parameters:
        values[name] = effect_parameter(name).typical * stretch(name, scale)
    return values | {k: v for k, v in known.items() if k in values}


def data_scale(model: ForwardModel, data: Measurements) -> float:
    """Units of the data in one kg m/s, roughly: their median over that of a middling grain (impact gain 1.5)."""
    # Dense enough that heavy loads fit on the paddles.
    values = {p.name: p.typical for p in GRAIN.values() if p.form in ("", "restitution")} | {"density": 1500.0}
    plain = model.with_effects(()).paddle_momentum(data.cells()[0], values, overfull="nan")
    middle = float(np.nanmedian(np.real(plain)))
    return float(np.median(data.momentum)) / middle if middle > 0.0 and np.median(data.momentum) > 0.0 else 1.0


class _Problem:
    """One calibration: rows, weights, bounds."""

    def __init__(
        self,
        model: ForwardModel,
        data: Measurements,
        start: Mapping[str, float],
        names: tuple[str, ...],
        prior: Prior | None,
        bounds: Bounds | None,
        robust: bool,
    ) -> None:
        if data.momentum.size < len(names) and prior is None:
            raise ValueError(f"{data.momentum.size} rows cannot fix {len(names)} parameters ({', '.join(names)})")
        missing = [n for n in names if n not in start]
        if missing:
            raise ValueError(f"free parameters {missing} are not among {list(start)}")
        self.model, self.data, self.names, self.robust = model, data, names, robust
        self.start = dict(start)
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
        self.prior_white, self.prior_mean = (
            prior.restricted(names).whitening(names) if prior is not None else (np.zeros((0, len(names))), np.zeros(len(names)))
        )
        self.unit = np.array([self._unit(n, lo, hi) for n, lo, hi in zip(names, self.lower, self.upper, strict=True)])

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
            return self._scatter(), dof
        y = self.data.momentum
        middle = np.array([np.median(y[self.cell == i]) for i in range(counts.size)])
        repeated = counts[self.cell] > 1
        spread = np.abs(y - middle[self.cell])[repeated] * np.sqrt(np.count_nonzero(repeated) / dof)
        return float(1.4826 * np.median(spread)), dof

    def _scatter(self) -> float:
        """Standard deviation of a row about the mean of its cell, in the momentum's unit; nan without replicates."""
        y, counts = self.data.momentum, np.bincount(self.cell)
        dof = int(np.sum(counts - 1))
        means = np.bincount(self.cell, y) / counts
        return float(np.sqrt(np.sum((y - means[self.cell]) ** 2) / dof)) if dof > 0 else float("nan")

    def _first_noise(self) -> float:
        largest = float(np.max(np.abs(self.data.momentum)))
        if np.isfinite(self.pure_sd) and self.pure_sd > 1e-9 * largest:
            return self.pure_sd
        return 0.01 * largest if largest > 0.0 else 1.0

    def draw(self, starts: int, rng: np.random.Generator) -> Array:
        """(starts, n): the given start, then random ones for which no load overfills a paddle."""
        first = np.clip([self.start[n] for n in self.names], self.lower, self.upper)
        low = np.clip([self.ranges[n][0] for n in self.names], self.lower, self.upper)
        high = np.clip([self.ranges[n][1] for n in self.names], self.lower, self.upper)
        theta = np.vstack((first[None], rng.uniform(low, high, (max(starts - 1, 0), len(self.names)))))
        for _ in range(20):
            bad = ~np.all(np.isfinite(self.momentum.value(theta)), axis=-1)
            if not np.any(bad):
                return theta
            theta[bad] = rng.uniform(low, high, (int(np.sum(bad)), len(self.names)))
        if np.all(bad):
            raise ValueError("no start within the bounds can carry the heaviest load; is density or paddle mass wrong?")
        usable: Array = theta[~bad]
        return usable

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

    def search(self, theta: Array, progress: Callable[[float], None] | None = None) -> tuple[BatchSearch, NDArray[np.intp]]:
        """Batched search; each of its results with the number of starts that it stands for."""

        def residuals(t: Array, _: NDArray[np.intp]) -> tuple[Array, Array]:
            return self.residuals(t, self.row_sd)

        leader = self._leaders(theta)
        at, follows = np.unique(leader, return_inverse=True)
        near = levenberg_marquardt(
            residuals,
            theta[at],
            self.lower,
            self.upper,
            scale=self.unit,
            iterations=60,
            tolerance=1e-4,
            least_gain=1e-4,
            progress=progress,
        )
        group = _groups(near.theta / self.unit, near.cost, _ONE_VALLEY)
        best = np.array([np.flatnonzero(group == g)[np.argmin(near.cost[group == g])] for g in range(int(group.max()) + 1)])
        found = levenberg_marquardt(residuals, near.theta[best], self.lower, self.upper, scale=self.unit)
        return found, np.bincount(group[follows.ravel()], minlength=best.size)

    def _leaders(self, theta: Array) -> NDArray[np.intp]:
        """For each start the one whose search it shares: its nearest better start, and so on, where that is within reach.

        The first (the given one) and the best are always searched.
        """
        count, width = theta.shape
        leader = np.arange(count)
        if count <= _ALWAYS_SEARCHED:
            return leader
        error = (self.momentum.value(theta)[:, self.cell] - self.data.momentum) / self.row_sd
        prior = np.einsum("pn,bn->bp", self.prior_white, theta - self.prior_mean)
        cost = np.sum(error**2, axis=1) + np.sum(prior**2, axis=1)
        order = np.argsort(cost, kind="stable")
        reach = (_LINKAGE * gamma(1.0 + 0.5 * width) * np.log(count) / count) ** (1.0 / width) / np.sqrt(np.pi)
        for rank, i in enumerate(order):
            if rank < _ALWAYS_SEARCHED or i == 0:
                continue
            away = np.linalg.norm((theta[order[:rank]] - theta[i]) / self.unit, axis=1)
            nearest = int(np.argmin(away))
            if away[nearest] < reach:
                leader[i] = leader[order[nearest]]
        return leader

    def polish(self, theta: Array, cost: Array, standing_for: NDArray[np.intp]) -> tuple[tuple[Basin, ...], Array]:
        """Distinct minima, each polished; the best parameter vector. standing_for: starts behind each point."""
        group = _groups(theta / self.unit, cost, _SAME_BASIN)
        inside = [np.flatnonzero(group == g) for g in range(min(int(group.max()) + 1, _MOST_BASINS))]
        best = theta[[rows[np.argmin(cost[rows])] for rows in inside]]
        polished = [
            (point, value, int(np.sum(standing_for[rows])))
            for (point, value), rows in zip(self._polished(best), inside, strict=True)
        ]
        merged: list[tuple[Array, float, int]] = []
        for point, value, count in sorted(polished, key=lambda item: item[1]):
            for k, (known, known_value, known_count) in enumerate(merged):
                if self._one_valley(point, value, known):
                    merged[k] = (known, known_value, known_count + count)
                    break
            else:
                merged.append((point, value, count))
        floor = max(merged[0][1], 1e-12 * self.data.momentum.size)
        basins = tuple(Basin(tuple(map(float, point)), value / floor, count) for point, value, count in merged)
        return basins, merged[0][0]

    def _one_valley(self, point: Array, value: float, known: Array) -> bool:
        """Whether no ridge lies between two points, or they are one point to the eye."""
        if np.max(np.abs(point - known) / self.unit) < _SAME_BASIN:
            return True
        between = known + np.linspace(0.0, 1.0, 7)[1:-1, None] * (point - known)
        return all(self._loss(t) <= value * (1.0 + 1e-6) for t in between)

    def _polished(self, theta: Array) -> list[tuple[Array, float]]:
        if self.robust:
            return [self._polish_robust(point) for point in theta]
        found = levenberg_marquardt(
            lambda t, _: self.residuals(t, self.row_sd),
            theta,
            self.lower,
            self.upper,
            scale=self.unit,
            tolerance=1e-12,
        )
        return [(point, float(value)) for point, value in zip(found.theta, found.cost, strict=True)]

    def _polish_robust(self, theta: Array) -> tuple[Array, float]:
        from scipy import optimize

        cache: dict[bytes, tuple[Array, Array]] = {}

        def both(t: Array) -> tuple[Array, Array]:
            key = t.tobytes()
            if key not in cache:
                cache.clear()
                r, j = self.residuals(t[None], self.row_sd)
                cache[key] = r[0], j[0]
            return cache[key]

        margin = 1e-12 * (self.upper - self.lower)
        inside = np.clip(theta, self.lower + margin, self.upper - margin)
        if not self.names or not np.all(np.isfinite(both(inside)[0])):
            return theta, float(0.5 * np.sum(both(theta)[0] ** 2))

        def residuals(t: Array) -> Array:
            return np.nan_to_num(both(t)[0], nan=1e6)

        def slopes(t: Array) -> Array:
            return np.nan_to_num(both(t)[1])

        solution = optimize.least_squares(
            residuals,
            inside,
            jac=slopes,
            bounds=(self.lower, self.upper),
            x_scale=self.unit,
            loss="soft_l1",
            f_scale=_ROBUST_SCALE,
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=200,
        )
        point = np.asarray(solution.x, dtype=float)
        # A trust-region interior method stops a hair short of a bound that the batched search sits on.
        near = np.where(
            point - self.lower < 1e-6 * self.unit, self.lower, np.where(self.upper - point < 1e-6 * self.unit, self.upper, point)
        )
        if self._loss(near) <= float(solution.cost) * (1.0 + 1e-9):
            point = near
        if self._loss(point) <= self._loss(theta):
            return point, self._loss(point)
        return theta, self._loss(theta)

    def _loss(self, theta: Array) -> float:
        r = self.residuals(theta[None], self.row_sd)[0][0]
        z = r * r
        if self.robust:
            z = 2.0 * _ROBUST_SCALE**2 * (np.sqrt(1.0 + z / _ROBUST_SCALE**2) - 1.0)
        total = 0.5 * float(np.sum(z))
        return total if np.isfinite(total) else float("inf")

    def result(self, theta: Array, basins: tuple[Basin, ...], starts: int, response_unit: str, intervals: bool) -> Calibration:
        value, jacobian = self.momentum(theta[None])
        predicted, slopes = value[0][self.cell], jacobian[0][self.cell]
        width = slopes.shape[1]
        error = predicted - self.data.momentum
        weight, factor, dof = self._noise(error, width)
        information = (slopes * weight[:, None]).T @ (slopes * weight[:, None]) / max(factor, 1e-300)
        information = information + self.prior_white.T @ self.prior_white
        free_cov, singular = _inverse(information, self.unit)
        # In the file a parameter is never less certain than anywhere between its bounds.
        bounded = np.diag(12.0 / (self.upper - self.lower) ** 2)
        covariance, _ = _inverse(information + bounded, self.unit)
        if np.any(singular):
            covariance = _bounded_inverse(information, self.upper - self.lower)
        size = self._learnt_error(error, jacobian[0])
        if size > 0.0:
            angle, speed, load, _ = self.data.columns()
            # A constant error is absorbed by the impact gain: it is none of the forces', but one of what they are made of.
            shapes = np.column_stack((model_error.basis(angle, load, speed), np.ones(load.size)))
            own = size * shapes * (model_error.level(predicted) * weight)[:, None]
            covariance = self._within_bounds(model_error.widened(covariance, slopes * weight[:, None] / max(factor, 1e-300), own))
        at_bound = [
            "lower" if t <= lo + 1e-9 * u else "upper" if t >= hi - 1e-9 * u else ""
            for t, lo, hi, u in zip(theta, self.lower, self.upper, self.unit, strict=True)
        ]
        errors = np.where(singular, np.inf, np.sqrt(np.maximum(np.diag(free_cov), 0.0)))
        ends = self._profile(theta, errors, weight, factor, dof) if intervals and width else self._wald(theta, errors, dof)
        fitted = tuple(
            FittedParameter(
                name,
                float(theta[i]),
                float(errors[i]),
                (float(ends[i, 0]), float(ends[i, 1])),
                bool(ends[i, 0] <= self.lower[i]),
                bool(ends[i, 1] >= self.upper[i]),
                at_bound[i],
            )
            for i, name in enumerate(self.names)
        )
        deviation = np.sqrt(np.diag(free_cov))
        with np.errstate(divide="ignore", invalid="ignore"):
            correlation = free_cov / np.outer(deviation, deviation)
        quality = self._quality(error, float(np.sqrt(factor)), width)
        columns = self.data.columns()
        flow = columns[2]
        if self.data.conditions.paddle_mass_kg is not None:
            flow = flow * self.model.machine.passes_per_s(columns[1])
        values = self.start | {n: float(v) for n, v in zip(self.names, theta, strict=True)}
        parameter_set = ParameterSet(
            values,
            self.names,
            covariance,
            CalibratedRange(
                _span(flow),
                _span(columns[0]),
                _span(columns[1]),
                _span(columns[3]) if np.all(np.isfinite(columns[3])) else None,
            ),
            response_unit,
            model_error=size if size > model_error.FLOOR else 0.0,
        )
        return Calibration(
            parameter_set,
            fitted,
            correlation,
            basins,
            starts,
            quality,
            predicted,
            slopes,
            tuple(_sentences(fitted, correlation, basins, starts, quality)),
        )

    def _learnt_error(self, error: Array, slopes: Array) -> float:
        """Relative size of the model's own error, from angles and loads left out, where replicates or a stated sigma part it from
        noise; else 0.

        error: of each row. slopes: of each cell.
        """
        if (self.pure_dof < _LEAST_PURE_DOF and not self.given_sigma) or not slopes.shape[1]:
            return 0.0
        count = np.bincount(self.cell)
        first = np.unique(self.cell, return_index=True)[1]
        angle, _, load, _ = self.data.columns()[:, first]
        mean = np.bincount(self.cell, error) / count
        predicted = np.bincount(self.cell, error + self.data.momentum) / count
        if self.given_sigma:
            noise = np.bincount(self.cell, self.row_sd**-2.0) ** -0.5
        else:
            noise = np.maximum(self.pure_sd, 1e-9 * float(np.max(np.abs(predicted)))) / np.sqrt(count)
        basis = orthonormal(slopes / noise[:, None] * self.unit)
        relative = noise / model_error.level(predicted)
        return model_error.learnt(mean / noise, basis, relative, model_error.groups_of(angle, load))

    def _within_bounds(self, covariance: Array) -> Array:
        """No parameter less certain than anywhere between its bounds."""
        most = (self.upper - self.lower) / np.sqrt(12.0)
        limit = np.minimum(1.0, most / np.sqrt(np.maximum(np.diag(covariance), 1e-300)))
        return np.asarray(covariance * np.outer(limit, limit))

    def _quality(self, error: Array, noise_factor: float, width: int) -> Residuals:
        rows = error.size
        rms = float(np.sqrt(np.mean(error**2)))
        largest = float(np.max(np.abs(self.data.momentum)))
        robust_sd = 1.4826 * float(np.median(np.abs(error / self.row_sd)))
        far = np.abs(error / self.row_sd) > _OUTLIER * robust_sd
        outliers = np.flatnonzero(far) if robust_sd > 0.0 else np.zeros(0, dtype=np.intp)
        f_value = p_value = float("nan")
        cells = int(self.cell.max()) + 1
        y = self.data.momentum
        weight = self.row_sd**-2.0
        means = np.bincount(self.cell, weight * y) / np.bincount(self.cell, weight)
        # Weighted as the fit was: rows of unlike sigma are no sample of one variance.
        pure_ss = float(np.sum(weight * (y - means[self.cell]) ** 2))
        pure_dof = rows - cells
        if pure_dof > 0 and cells > width and pure_ss > 0.0:
            lack = (float(np.sum(weight * error**2)) - pure_ss) / (cells - width)
            f_value = lack / (pure_ss / pure_dof)
            p_value = float(fdtrc(cells - width, pure_dof, f_value))
        return Residuals(
            rows,
            rms,
            100.0 * rms / largest,
            noise_factor * (1.0 if self.given_sigma else float(self.row_sd[0])),
            self._scatter(),
            pure_dof,
            f_value,
            p_value,
            tuple(int(i) for i in (outliers if self.data.places is None else self.data.places[outliers])),
        )

    def _wald(self, theta: Array, errors: Array, dof: int) -> Array:
        reach = stdtrit(dof, 0.5 + 0.5 * CONFIDENCE) * np.where(np.isfinite(errors), errors, np.inf)
        return np.stack((np.maximum(theta - reach, self.lower), np.minimum(theta + reach, self.upper)), axis=-1)

    def curves(self, fitted: Calibration, points: int) -> tuple[ProfileCurve, ...]:
        """See `profile_curves`."""
        theta = np.array([p.value for p in fitted.parameters])
        width = theta.size
        value, _ = self.momentum(theta[None])
        weight, factor, dof = self._noise(value[0][self.cell] - self.data.momentum, width)
        row_sd = np.sqrt(max(factor, 1e-300)) / weight
        grids = [self._span_of(p, points) for p in fitted.parameters]
        start = np.tile(theta, (width * points, 1))
        index = np.repeat(np.arange(width), points)
        start[np.arange(index.size), index] = np.concatenate(grids)
        held = index[:, None] == np.arange(width)
        found = levenberg_marquardt(
            lambda t, _: self.residuals(t, row_sd),
            start,
            self.lower,
            self.upper,
            held=held,
            iterations=60,
            tolerance=1e-5,
        )
        best = float(np.sum(self.residuals(theta[None], row_sd)[0] ** 2))
        rise = np.sqrt(np.maximum(2.0 * found.cost - best, 0.0)).reshape(width, points)
        limit = float(np.sqrt(fdtri(1, dof, CONFIDENCE)))
        return tuple(
            ProfileCurve(p.name, grid, np.where(np.isfinite(line), np.copysign(line, grid - p.value), np.nan), limit)
            for p, grid, line in zip(fitted.parameters, grids, rise, strict=True)
        )

    def _span_of(self, parameter: FittedParameter, points: int) -> Array:
        """Ascending, with the fitted value among them where it lies inside."""
        i = self.names.index(parameter.name)
        low, high = (parameter.value + 1.6 * (end - parameter.value) for end in parameter.interval)
        low, high = max(low, self.lower[i]), min(high, self.upper[i])
        half = points // 2
        if low < parameter.value < high:
            return np.concatenate(
                (np.linspace(low, parameter.value, half, endpoint=False), np.linspace(parameter.value, high, points - half))
            )
        return np.linspace(low, high, points)

    def _noise(self, error: Array, width: int) -> tuple[Array, float, int]:
        """Weight of each row, what its variance is multiplied by, degrees of freedom."""
        weight = 1.0 / self.row_sd
        if self.robust:
            weight = weight * (1.0 + (error * weight / _ROBUST_SCALE) ** 2) ** -0.25
        dof = max(error.size - width + len(self.prior_white), 1)
        inflation = float(np.sum((error * weight) ** 2) / dof)
        # A given sigma counts unless the residuals say it is too small (Birge's ratio).
        return weight, max(inflation, 1.0) if self.given_sigma else inflation, dof

    def _profile(self, theta: Array, errors: Array, weight: Array, factor: float, dof: int) -> Array:
        """(n, 2): where the best fit over the other parameters gets worse by the F quantile; a bound where it never does."""
        width = theta.size
        limit = float(fdtri(1, dof, CONFIDENCE))
        sign = np.tile([-1.0, 1.0], width)
        index = np.repeat(np.arange(width), 2)
        lines = np.arange(2 * width)
        row_sd = np.sqrt(max(factor, 1e-300)) / weight
        size = np.clip(np.where(np.isfinite(errors), errors, self.unit), 1e-12 * self.unit, self.unit)

        def residuals(t: Array, _: NDArray[np.intp]) -> tuple[Array, Array]:
            return self.residuals(t, row_sd)

        best = float(np.sum(self.residuals(theta[None], row_sd)[0] ** 2))
        room = np.where(sign < 0.0, theta[index] - self.lower[index], self.upper[index] - theta[index])
        guess = np.sqrt(limit) * np.where(np.isfinite(errors[index]), errors[index], np.inf)
        near, near_rise = np.zeros(2 * width), np.zeros(2 * width)
        far, far_rise = np.minimum(guess, room), np.full(2 * width, np.nan)
        held = np.zeros((2 * width, width), dtype=bool)
        held[lines, index] = True
        current = np.tile(theta, (2 * width, 1))
        place = far.copy()
        open_end = np.zeros(2 * width, dtype=bool)
        done = room <= 0.0
        open_end |= done
        for _ in range(14):
            if np.all(done):
                break
            at = np.flatnonzero(~done)
            trial = current[at].copy()
            trial[np.arange(at.size), index[at]] = (theta[index] + sign * place)[at]
            found = levenberg_marquardt(
                residuals, trial, self.lower, self.upper, held=held[at], scale=size, iterations=25, tolerance=1e-4
            )
            rise = np.sqrt(np.maximum(2.0 * found.cost - best, 0.0))
            short = rise < np.sqrt(limit)
            current[at] = np.where(np.isfinite(found.cost)[:, None], found.theta, current[at])
            for k, i in enumerate(at):
                if short[k]:
                    near[i], near_rise[i] = place[i], rise[k]
                    if place[i] >= room[i] * (1.0 - 1e-12):
                        open_end[i], done[i] = True, True
                        continue
                else:
                    far[i], far_rise[i] = place[i], rise[k]
                if abs(rise[k] - np.sqrt(limit)) < 0.01 * np.sqrt(limit):
                    done[i] = True
                    continue
                if np.isnan(far_rise[i]):
                    ratio = np.sqrt(limit) / max(near_rise[i], 0.1 * np.sqrt(limit))
                    place[i] = min(max(near[i] * ratio * 1.05, near[i] + 1e-9 * room[i]), room[i])
                elif np.isfinite(far_rise[i]):
                    share = (np.sqrt(limit) - near_rise[i]) / max(far_rise[i] - near_rise[i], 1e-300)
                    place[i] = near[i] + np.clip(share, 0.05, 0.95) * (far[i] - near[i])
                else:
                    place[i] = 0.5 * (near[i] + far[i])
        out = theta[index] + sign * place
        out = np.where(open_end, np.where(sign < 0.0, self.lower[index], self.upper[index]), out)
        return out.reshape(width, 2)


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


def _bounded_inverse(information: Array, span: Array) -> Array:
    """Covariance where the information leaves directions free: in those, that of anywhere between the bounds.

    The information of rows without noise is so large that the bounds' own, added to it, would be lost in rounding.
    """
    sd = span / np.sqrt(12.0)
    values, vectors = np.linalg.eigh(information * np.outer(sd, sd))
    values = np.where(values <= 1e-13 * max(float(values[-1]), 0.0), 0.0, values)
    covariance = (vectors / (1.0 + values)) @ vectors.T * np.outer(sd, sd)
    return np.asarray(0.5 * (covariance + covariance.T))


def _span(values: Iterable[float]) -> tuple[float, float]:
    array = np.asarray(list(values))
    return float(array.min()), float(array.max())


def _sentences(
    fitted: Sequence[FittedParameter], correlation: Array, basins: Sequence[Basin], starts: int, quality: Residuals
) -> Iterable[str]:
    for p in fitted:
        low, high = p.interval
        if p.open_below and p.open_above:
            yield f"{p.name} is not determined: every value from {low:.6g} to {high:.6g} fits these data within their noise."
        elif p.at_bound:
            yield at_bound_sentence(p.name, p.at_bound, p.value)
        elif p.open_below or p.open_above:
            side = f"at or below {high:.6g}" if p.open_below else f"at or above {low:.6g}"
            yield f"{p.name} is determined on one side only: the data say it is {side}."
        elif not np.isfinite(p.standard_error):
            yield f"{p.name} is not determined: another parameter can make up for any change of it."
    for i in range(len(fitted)):
        for j in range(i):
            if abs(correlation[i, j]) > 0.98:
                yield (
                    f"{fitted[j].name} and {fitted[i].name} trade off against each other (correlation "
                    f"{correlation[i, j]:.4f}); know one from elsewhere to fix the other."
                )
    if len(basins) > 1 and starts > 1:
        counts = ", ".join(str(b.starts) for b in basins)
        yield f"{len(basins)} distinct minima were found (starts that ended in each: {counts}); the best one is reported."
    if quality.lack_of_fit_p < 0.001:
        yield (
            f"the model misses by more than the replicates scatter (lack-of-fit F = {quality.lack_of_fit_f:.3g}, p < 0.001): "
            "an effect is missing; see yieldmon diagnose."
        )
    if quality.outlier_rows:
        rows = ", ".join(str(i + 1) for i in quality.outlier_rows[:10])
        yield f"rows {rows} lie more than {_OUTLIER:g} robust standard deviations from the fit; look at them, or use --robust."
