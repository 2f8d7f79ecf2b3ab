"""System calibration: grain and effect parameters from rows of known load and measured momentum.

Many starts are searched (`multistart`), the best fit is kept and examined: standard errors (`fit_uncertainty`), intervals
(`profile_likelihood`), replicates, outliers. Sources: thesis chapter 9.1 (multistart least squares); Draper and Smith, "Applied
Regression Analysis" (pure error and lack of fit).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from yieldmon.estimation import model_error
from yieldmon.estimation.gaussian import SD_PER_MAD
from yieldmon.estimation.parameters import CalibratedRange, ParameterSet
from yieldmon.estimation.priors import Bounds, Prior, stretch
from yieldmon.physics.effects import effect_parameter
from yieldmon.physics.grain import EXCHANGE_FORM, GRAIN, RESTITUTION_FORM
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array, span

from . import angle_lines, multistart, profile_likelihood
from .calibration_problem import CalibrationProblem, data_scale, residual_moments
from .calibration_result import (
    Basin,
    Calibration,
    FittedParameter,
    ProfileCurve,
    Residuals,
    of_model_error,
    of_outliers,
    sentences,
)
from .fit_uncertainty import FitUncertainty, fit_uncertainty, wald_intervals
from .measurements import Measurements
from .scatter_law import LEAST_PURE_DOF, OUTLIER_SDS

_NO_NOISE = (
    "there are no more rows than parameters, so that they do not show their noise: it is taken for 1 % of the largest reading; "
    "state it (column sigma), or measure more rows."
)
_OTHER_SIGMA = 3.0
"""Ratio of the rows' scatter to the stated sigma, or its inverse, above which the user is asked about the sigma."""
_OTHER_STARTS = 3
"""Searches with plate angles from another line."""


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
    """Fit the free parameters to the momentum of rows of known load, by least squares.

    Parameters
    ----------
    model : ForwardModel
    data : Measurements
    start : mapping of str to float
        Values of all parameters of the model; those not free keep theirs, a free one outside its bounds begins at the nearer
        bound. See `default_start`.
    free : sequence of str
        Parameters to fit; a single name may stand alone.
    prior : Prior, optional
        Gaussian, on free parameters.
    bounds : mapping of str to (float, float), optional
        In place of the published or physical ones.
    starts : int
        Searches, 1 or more: one from `start`, the others from random places within the bounds.
    rng : numpy.random.Generator, optional
        Of the random places; None: seed 0.
    robust : bool
        Soft-L1 loss, for tables with outliers.
    intervals : bool
        Profile-likelihood intervals; False: by the standard errors alone.
    response_unit : str
        Unit of the reading, "N" for a force.
    progress : callable, optional
        Called with the share done, 0 .. 1.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        For fewer rows than free parameters, for parameters, bounds or starts that make no search, or where the model cannot carry
        the loads.

    References
    ----------
    Bates and Watts, "Nonlinear Regression Analysis and Its Applications" (Wiley, 1988), chapters 2 and 6.

    Examples
    --------
    >>> model, free = api.ForwardModel(api.Machine()), ["restitution", "friction"]
    >>> grain = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
    >>> angle, flow = (each.ravel() for each in np.meshgrid(np.radians([40.0, 60.0, 80.0]), [5.0, 10.0, 15.0]))
    >>> at = api.Conditions(angle, 400.0 * api.RPM, mass_flow_kg_s=flow)
    >>> data = api.Measurements(at, model.paddle_momentum(at, grain))
    >>> start = api.default_start(model, data, ["restitution"], grain | {"friction": 0.3})
    >>> found = api.calibrate(model, data, start, free, starts=1)
    >>> {name: round(found.parameter_set.values[name], 3) for name in free}
    {'restitution': 0.6, 'friction': 0.2}
    """
    found = search(model, data, start, free, prior=prior, bounds=bounds, starts=starts, rng=rng, robust=robust, progress=progress)
    return examine(found, intervals=intervals, response_unit=response_unit)


@dataclass(frozen=True, slots=True)
class Searched:
    """What the searches of a calibration found, before it is examined.

    Parameters
    ----------
    problem : CalibrationProblem
    basins : tuple of Basin
        Distinct minima, best first.
    theta : ndarray (n,)
        Free parameters at the best one.
    starts : int
        Searches made.
    """

    problem: CalibrationProblem
    basins: tuple[Basin, ...]
    theta: Array
    starts: int

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of the parameters that ended at a bound."""
        sides = _bound_sides(self.problem, self.theta)
        return tuple(name for name, side in zip(self.problem.names, sides, strict=True) if side)


def search(
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
    progress: Callable[[float], None] | None = None,
) -> Searched:
    """The least squares of `calibrate`, with its arguments and errors, without what is derived from the best fit."""
    if starts < 1:
        raise ValueError(f"starts {starts}: expected 1 or more")
    names = (free,) if isinstance(free, str) else tuple(free)
    problem = CalibrationProblem(model, data, start, names, prior=prior, bounds=bounds, robust=robust)
    basins, theta = multistart.minimize(problem, starts, np.random.default_rng(0) if rng is None else rng, progress)
    return Searched(problem, basins, theta, starts)


def examine(searched: Searched, *, intervals: bool = True, response_unit: str = "N") -> Calibration:
    """Standard errors, intervals and quality of the best fit; `intervals` and `response_unit` as of `calibrate`."""
    problem = searched.problem
    found = _examined(searched, response_unit, intervals)

    def misfit(plate_angle_rad: Array) -> float:
        data = problem.data
        turned = problem.of(replace(data, conditions=replace(data.conditions, plate_angle_rad=plate_angle_rad)))
        _, theta = multistart.minimize(turned, _OTHER_STARTS, np.random.default_rng(0), None)
        error = turned.momentum(theta[None])[0][0][turned.cell] - data.momentum
        return float(np.sqrt(np.mean(error**2))) / float(np.max(np.abs(data.momentum)))

    asked = angle_lines.question(problem.data.columns()[0], found.residuals.rms_over_max_pct / 100.0, misfit)
    return replace(found, sentences=(*found.sentences, asked)) if asked else found


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
    problem = CalibrationProblem(
        model, data, fitted.parameter_set.values, fitted.names, prior=prior, bounds=bounds, robust=robust
    )
    return profile_likelihood.curves(problem, fitted.parameters, points)


def default_start(
    model: ForwardModel, data: Measurements, impact: Sequence[str], known: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Start values for `calibrate`.

    Parameters
    ----------
    model : ForwardModel
    data : Measurements
        Gives the scale of parameters that are in a response's own unit.
    impact : sequence of str
        "restitution", or "k1" and "k2"; other grain parameters may stand beside them.
    known : mapping of str to float, optional
        Values that are given.

    Returns
    -------
    dict of str to float
        All parameters of the model: the given ones, else middling grain and effects at their typical size.

    Raises
    ------
    ValueError
        For a name in `impact` that is no grain parameter.

    Examples
    --------
    >>> at = api.Conditions(np.radians([50.0, 70.0]), 400.0 * api.RPM, mass_flow_kg_s=np.array([5.0, 10.0]))
    >>> rows = api.Measurements(at, np.array([4.2, 7.4]))
    >>> sorted(api.default_start(api.ForwardModel(api.Machine()), rows, ["restitution"]))
    ['density', 'friction', 'restitution', 'shape_ratio']
    """
    if not set(impact) <= set(GRAIN):
        raise ValueError(f"impact {impact!r}: expected {list(RESTITUTION_FORM)} or {list(EXCHANGE_FORM)}")
    known = dict(known or {})
    scale = data_scale(model, data) if any(GRAIN[name].follows_response for name in impact) else 1.0
    chosen = (*(p.name for p in GRAIN.values() if not p.form), *impact)
    values = {name: GRAIN[name].typical * stretch(name, scale) for name in chosen}
    for name in model.effect_parameters:
        values[name] = effect_parameter(name).typical * stretch(name, scale)
    return values | {k: v for k, v in known.items() if k in values}


def _examined(searched: Searched, response_unit: str, intervals: bool) -> Calibration:
    """What the best fit says, and how well."""
    problem, theta = searched.problem, searched.theta
    value, jacobian = problem.momentum(theta[None])
    predicted, slopes = value[0][problem.cell], jacobian[0][problem.cell]
    error = predicted - problem.data.momentum
    noise = problem.noise(error, slopes)
    uncertainty = fit_uncertainty(problem, theta, predicted, slopes, jacobian[0], noise)
    errors = uncertainty.standard_errors
    if intervals and theta.size:
        ends = profile_likelihood.intervals(problem, theta, uncertainty, noise)
    else:
        ends = wald_intervals(problem, theta, errors, noise.dof)
    fitted = _fitted(problem, theta, errors, ends)
    quality = _quality(problem, error, jacobian[0], noise.variance_factor)
    known = _parameter_set(problem, theta, uncertainty, response_unit)
    return Calibration(
        parameter_set=known,
        parameters=fitted,
        correlation=uncertainty.correlation,
        basins=searched.basins,
        starts=searched.starts,
        residuals=quality,
        predicted=predicted,
        jacobian=slopes,
        sentences=(
            *sentences(fitted, uncertainty.correlation, searched.basins, searched.starts, quality, problem.model.effects),
            *of_outliers(quality.outlier_rows, robust=problem.robust),
            *of_model_error(fitted, known),
            *(() if problem.shows_noise or problem.given_sigma else (_NO_NOISE,)),
            *_of_sigma(problem, error),
        ),
    )


def _of_sigma(problem: CalibrationProblem, error: Array) -> Iterator[str]:
    """That the sigma given is another one than the rows show, error: of each of them."""
    if not problem.given_sigma:
        return
    dof = error.size - len(problem.names) + len(problem.prior_white)
    left = float(np.sqrt(np.sum((error / problem.row_sd) ** 2) / max(dof, 1)))
    if dof >= LEAST_PURE_DOF and left < 1.0 / _OTHER_SIGMA:
        yield f"sigma is {1.0 / max(left, 1e-99):.2g} times what the fit misses the rows by: is it in the unit of the reading?"
    weight = problem.row_sd**-2.0
    mean = np.bincount(problem.cell, weight * problem.data.momentum) / np.bincount(problem.cell, weight)
    repeats = np.sum(weight * (problem.data.momentum - mean[problem.cell]) ** 2)
    within = float(np.sqrt(repeats / max(problem.pure_dof, 1)))
    if problem.pure_dof >= LEAST_PURE_DOF and within > _OTHER_SIGMA:
        yield f"repeated rows scatter by {within:.2g} times their sigma: is it in the unit of the reading, and of one row?"


def _bound_sides(problem: CalibrationProblem, theta: Array) -> list[str]:
    """For each free parameter the bound that it is at, "lower" or "upper", else ""."""
    return [("", "upper", "lower")[side] for side in problem.bound_sides(theta).tolist()]


def _fitted(problem: CalibrationProblem, theta: Array, errors: Array, ends: Array) -> tuple[FittedParameter, ...]:
    at_bound = _bound_sides(problem, theta)
    return tuple(
        FittedParameter(
            name=name,
            value=float(theta[i]),
            standard_error=float(errors[i]),
            interval=(float(ends[i, 0]), float(ends[i, 1])),
            open_below=bool(ends[i, 0] <= problem.lower[i]),
            open_above=bool(ends[i, 1] >= problem.upper[i]),
            at_bound=at_bound[i],
        )
        for i, name in enumerate(problem.names)
    )


def _parameter_set(problem: CalibrationProblem, theta: Array, uncertainty: FitUncertainty, response_unit: str) -> ParameterSet:
    return ParameterSet(
        problem.start | {n: float(v) for n, v in zip(problem.names, theta, strict=True)},
        problem.names,
        uncertainty.covariance,
        _calibrated_range(problem.model, problem.data),
        response_unit,
        model_error=model_error.stated(uncertainty.model_error),
    )


def _calibrated_range(model: ForwardModel, data: Measurements) -> CalibratedRange:
    angle, speed, load, moisture = data.columns()
    flow = load if data.conditions.paddle_mass_kg is None else load * model.machine.passes_per_s(speed)
    return CalibratedRange(span(flow), span(angle), span(speed), span(moisture) if np.all(np.isfinite(moisture)) else None)


def _quality(problem: CalibrationProblem, error: Array, cell_slopes: Array, variance_factor: float) -> Residuals:
    rows, width = error.size, len(problem.names)
    rms = float(np.sqrt(np.mean(error**2)))
    largest = float(np.max(np.abs(problem.data.momentum)))
    relative = np.abs(error) / (problem.row_sd if problem.spread is None else problem.row_sd * np.sqrt(problem.spread))
    robust_sd = SD_PER_MAD * float(np.median(relative))
    far = relative > OUTLIER_SDS * robust_sd
    outliers = np.flatnonzero(far) if robust_sd > 0.0 else np.zeros(0, dtype=np.intp)
    f_value = p_value = float("nan")
    cells = int(problem.cell.max()) + 1
    y = problem.data.momentum
    weight = problem.row_sd**-2.0
    means = np.bincount(problem.cell, weight * y) / np.bincount(problem.cell, weight)
    # Weighted as the fit was: rows of unlike sigma are no sample of one variance.
    pure_ss = float(np.sum(weight * (y - means[problem.cell]) ** 2))
    pure_dof = rows - cells
    if pure_dof > 0 and cells > width and pure_ss > 0.0:
        lack = (float(np.sum(weight * error**2)) - pure_ss) / (cells - width)
        f_value = lack / (pure_ss / pure_dof)
        p_value = _lack_of_fit_p(problem, cell_slopes, f_value)
    return Residuals(
        rows=rows,
        rms=rms,
        rms_over_max_pct=100.0 * rms / largest,
        noise_sd=float(np.sqrt(variance_factor)) * (1.0 if problem.given_sigma else float(problem.row_sd[0])),
        pure_error_sd=problem.scatter(),
        pure_error_dof=pure_dof,
        lack_of_fit_f=f_value,
        lack_of_fit_p=p_value,
        outlier_rows=tuple(int(i) for i in (outliers if problem.data.places is None else problem.data.places[outliers])),
    )


def _lack_of_fit_p(problem: CalibrationProblem, cell_slopes: Array, f_value: float) -> float:
    """Probability of a larger F by noise alone, which may differ from cell to cell."""
    count = np.bincount(problem.cell)
    above, below = float(count.size - len(problem.names)), float(problem.pure_dof)
    if problem.spread is not None:
        first = np.unique(problem.cell, return_index=True)[1]
        variance = problem.spread[first]
        mean, share = residual_moments(cell_slopes * np.sqrt(count)[:, None] * problem.unit, variance)
        f_value /= mean
        # Within cells the mean variance is 1 by the spread's definition.
        above, below = above * share, below**2 / float((count - 1) @ variance**2)
    return float(scipy.special.fdtrc(above, below, f_value))
