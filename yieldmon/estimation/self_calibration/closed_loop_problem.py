"""The closed loop as a least-squares problem.

Data are the sweeps' windows, the prior and weighed masses. The unknown vector holds the parameters (n), the logarithm of each
sweep's flow (S), the slope of each flow (S) if flows are linear in time, and the model's relative error at each plate angle (A)
if there are several sweeps, to which it is common. For a single sweep that error is counted as noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.clusters import cluster
from yieldmon.estimation.fitting.least_squares import levenberg_marquardt
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import Prior, physical_bounds, search_bounds
from yieldmon.physics.effects.other_monitor import BIAS
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

from .closed_loop_forces import ClosedLoopForces, Forces, UnknownLayout
from .closed_loop_inputs import MeasuredDensity, Sweep, WeighedMass
from .flow_process import correlation, process_sd

_LEAST_FLOW_KG_S, _LARGEST_FLOW_KG_S = 1e-3, 1e3
_AT_END = 1e-6
"""Distance of ln(flow) from the least flow within which a search has ended there."""
_LARGEST_ERROR = 0.9
"""Largest relative error of the model at an angle."""
_LEAST_GAIN = 1e-8
"""Least decrease of chi-square for a further step, as of one by 1e-4 standard deviations."""


@dataclass(frozen=True, slots=True)
class Solution:
    """The solution of a `ClosedLoopProblem`.

    Attributes
    ----------
    unknown : ndarray (u,)
        The most likely unknown vector.
    residual, jacobian : ndarray (m,), (m, u)
        Whitened residuals there, and their derivatives.
    covariance : ndarray (u, u)
        Of the unknown, by Laplace's approximation.
    whiteners : tuple of ndarray (windows, windows)
        Inverse Cholesky factor of each sweep's force covariance.
    flow_covariances : tuple of ndarray (windows, windows)
        Covariance of each sweep's ln(flow) about its level, if the flow is a random process; else empty.
    """

    unknown: Array
    residual: Array
    jacobian: Array
    covariance: Array
    whiteners: tuple[Array, ...]
    flow_covariances: tuple[Array, ...]


_Term = tuple[Array, Array]
"""Whitened residuals (r,) and their derivatives (r, u)."""


class ClosedLoopProblem:
    """Sweeps, masses and prior, as residuals of one unknown vector.

    Attributes
    ----------
    names : tuple of str
        Parameters with a variance.
    white : ndarray (n, n)
        Inverse of the lower Cholesky factor of the prior's covariance.
    lower, upper : ndarray (n,)
        Bounds of the parameters.
    fixed : dict
        Parameters without a variance.
    windows : int
        Windows of all sweeps.
    sweep_rows : list of slice
        Rows of each sweep among the residuals and the windows.
    layout : UnknownLayout
        Order of the unknown vector.
    at_angle : ndarray (windows, A)
        1 if a window is at the angle, else 0; no columns if the model error is not part of the unknown.
    """

    def __init__(
        self,
        model: ForwardModel,
        prior: ParameterSet,
        sweeps: Sequence[Sweep],
        masses: Sequence[WeighedMass],
        density: MeasuredDensity | None,
        settings: ClosedLoopSettings,
    ) -> None:
        if set(prior.effects) != set(model.effects):
            raise ValueError(f"the parameters name the effects {prior.effects}; the model has {model.effects}")
        if not sweeps and not masses and density is None:
            raise ValueError("neither a sweep nor a weighed mass to estimate parameters from")
        self.model, self.prior_set, self.sweeps, self.masses = model, prior, tuple(sweeps), tuple(masses)
        self.settings = settings
        self.prior = Prior.of(prior)
        self.names = self.prior.names
        if not self.names:
            raise ValueError("the parameters have no covariance: every one of them counts as exactly known")
        if density is not None and "density" not in self.names:
            raise ValueError("a measured density needs density among the parameters with a variance")
        self.density = density
        self.white, _ = self.prior.whitening(self.names)
        self.fixed = {k: v for k, v in prior.values.items() if k not in self.names}
        weighed = bool(masses) or density is not None
        bounds = [self._bounds(n, float(m), weighed=weighed) for n, m in zip(self.names, self.prior.mean, strict=True)]
        self.lower, self.upper = (np.array(ends) for ends in zip(*bounds, strict=True))
        self.windows = sum(s.force_n.size for s in self.sweeps)
        self.at_angle = self._angles_in_common()
        slopes = len(self.sweeps) if settings.flow == "linear" else 0
        self.layout = UnknownLayout(len(self.names), len(self.sweeps), slopes, self.at_angle.shape[1])
        self._forces = ClosedLoopForces(model, self.layout, self.names, self.fixed, self.sweeps, self.masses)
        self.sweep_rows = self._forces.sweep_rows

    def _bounds(self, name: str, mean: float, *, weighed: bool) -> tuple[float, float]:
        """Limits of a parameter: the search range of calibrations for sweeps alone; the physical range if something was weighed
        or the prior's value lies outside the search range."""
        scale = _impact_scale(self.prior_set.values)
        low, high = search_bounds(name, scale)
        if weighed or not low <= mean <= high:
            low, high = physical_bounds(name, scale)
        return min(low, mean), max(high, mean)

    def _angles_in_common(self) -> Array:
        if len(self.sweeps) < 2 or self.settings.model_error == 0.0:
            return np.zeros((self.windows, 0))
        of_window = cluster(np.concatenate([s.plate_angle_rad for s in self.sweeps]), SAME_ANGLE_RAD)
        return np.asarray(of_window[:, None] == np.unique(of_window), dtype=float)

    def solve(self) -> Solution:
        """Find the most likely unknown. Raises ValueError if no flow can explain a sweep or a weighed load."""
        layout, settings = self.layout, self.settings
        flows = self._forces.start(self.prior_set, self.prior.mean)
        unknown = layout.vector(self.prior.mean, np.log(flows), 0.0, 0.0)
        low = layout.vector(self.lower, np.log(_LEAST_FLOW_KG_S), -1.0, -_LARGEST_ERROR)
        high = layout.vector(self.upper, np.log(_LARGEST_FLOW_KG_S), 1.0, _LARGEST_ERROR)
        unit = layout.vector(self.prior.standard_deviation, 0.1, 0.01, settings.model_error)
        # The noise by flow and model error depends on the solution, so both are computed alternately.
        passes = 3 if self.sweeps and (settings.flow == "process" or settings.model_error > 0.0) else 1
        for _ in range(passes):
            whiteners, flow_covariances = self._noise(unknown)
            found = levenberg_marquardt(
                partial(self._residuals, whiteners),
                unknown[None],
                low,
                high,
                scale=unit,
                iterations=40,
                tolerance=1e-4,
                least_gain=_LEAST_GAIN if self.masses else 0.0,
                track_curvature=bool(self.masses),
            )
            if not np.isfinite(found.cost[0]):
                raise ValueError("no flow below a full paddle explains a sweep with the prior's parameters")
            moved = float(np.max(np.abs(found.theta[0] - unknown) / unit))
            unknown = found.theta[0]
            if moved < 0.05:
                break
        empty = np.flatnonzero(unknown[layout.of_flows] <= np.log(_LEAST_FLOW_KG_S) + _AT_END)
        if empty.size:
            sweep, of = empty[0] + 1, layout.sweeps
            raise ValueError(f"sweep {sweep} of {of}: its forces are those of an empty machine, without a flow to find")
        jacobian = found.jacobian[0]
        covariance = _inverse(jacobian.T @ jacobian, unit)
        return Solution(unknown, found.residual[0], jacobian, covariance, tuple(whiteners), tuple(flow_covariances))

    def _noise(self, unknown: Array) -> tuple[list[Array], list[Array]]:
        """Inverse of the lower Cholesky factor of each sweep's force covariance, and the covariance of its ln(flow)."""
        settings = self.settings
        own_error = 0.0 if self.at_angle.size else settings.model_error
        if not self.sweeps or (settings.flow != "process" and own_error == 0.0):
            return [np.diag(1.0 / sweep.force_std_dev_n) for sweep in self.sweeps], []
        found = self._forces.at(unknown)
        whiteners: list[Array] = []
        covariances: list[Array] = []
        for sweep, rows, clock in zip(self.sweeps, self.sweep_rows, self._forces.clocks, strict=True):
            force, elastic = found.force[rows], found.elastic[rows]
            noise = np.diag(sweep.force_std_dev_n**2)
            if own_error > 0.0:
                lag = (sweep.plate_angle_rad[:, None] - sweep.plate_angle_rad) / SAME_ANGLE_RAD
                noise += own_error**2 * np.exp(-(lag**2)) * np.outer(force, force)
            if settings.flow == "process":
                sd = process_sd(
                    (sweep.force_n - force) / elastic,
                    sweep.force_std_dev_n / elastic,
                    sweep.plate_angle_rad,
                    clock,
                    settings.flow_process_time_s,
                    settings.flow_process_sd,
                )
                covariances.append(sd**2 * correlation(clock, settings.flow_process_time_s))
                noise += covariances[-1] * np.outer(elastic, elastic)
            whiteners.append(np.linalg.inv(np.linalg.cholesky(noise)))
        return whiteners, covariances

    def _residuals(self, whiteners: Sequence[Array], batch: Array, _: NDArray[np.intp]) -> tuple[Array, Array]:
        """Whitened residuals (1, m) and derivatives (1, m, u) of windows, prior, slopes, model errors, masses and density, of a
        batch of one unknown vector (1, u)."""
        unknown, layout = batch[0], self.layout
        found = self._forces.at(unknown)
        by_parameters = np.zeros((layout.parameters, unknown.size))
        by_parameters[:, layout.of_parameters] = self.white
        terms = [
            *self._window_terms(unknown, found, whiteners),
            (self.white @ (unknown[layout.of_parameters] - self.prior.mean), by_parameters),
            _independent(unknown, layout.of_slopes, 0.0, self.settings.flow_slope_sd_per_s),
            _independent(unknown, layout.of_errors, 0.0, self.settings.model_error),
            *self._mass_terms(unknown, found),
        ]
        if self.density is not None:
            place = self.names.index("density")
            place_of = slice(place, place + 1)
            terms.append(_independent(unknown, place_of, self.density.density_kg_m3, self.density.std_dev_kg_m3))
        residuals, jacobians = zip(*terms, strict=True)
        return np.concatenate(residuals)[None], np.vstack(jacobians)[None]

    def _window_terms(self, unknown: Array, found: Forces, whiteners: Sequence[Array]) -> Iterator[_Term]:
        layout, errors, missed = self.layout, unknown[self.layout.of_errors], self.model_errors_n(unknown)
        for i, (rows, whitener) in enumerate(zip(self.sweep_rows, whiteners, strict=True)):
            jacobian = np.zeros((len(whitener), unknown.size))
            factor = 1.0 + self.at_angle[rows] @ errors
            jacobian[:, layout.of_parameters] = found.by_theta[rows] * factor[:, None]
            jacobian[:, layout.of_errors] = self.at_angle[rows] * found.force[rows, None]
            elastic = found.elastic[rows] * factor
            jacobian[:, layout.of_flows.start + i] = elastic
            if layout.slopes:
                jacobian[:, layout.of_slopes.start + i] = elastic * self._forces.clocks[i]
            yield whitener @ (found.force[rows] + missed[rows] - self._forces.measured[rows]), whitener @ jacobian

    def _mass_terms(self, unknown: Array, found: Forces) -> Iterator[_Term]:
        for mass, rows in zip(self.masses, self._forces.weighed_rows, strict=True):
            by_load = found.by_load[rows]
            # The last Newton step of the flows that explain the forces.
            flow = found.load[rows] + (self._forces.measured[rows] - found.force[rows]) / by_load
            error_kg, sd_kg = float(mass.duration_s @ flow - mass.reference_kg), mass.std_dev_kg
            by = np.zeros((1, unknown.size))
            by[0, self.layout.of_parameters] = -(mass.duration_s / by_load) @ found.by_theta[rows]
            if mass.common_kg > 0.0 and BIAS in self.names:
                place = self.names.index(BIAS)
                error_kg -= mass.common_kg * unknown[place]
                by[0, place] -= mass.common_kg
                sd_kg = (sd_kg**2 - mass.common_kg**2) ** 0.5
            yield np.array([error_kg / sd_kg]), by / sd_kg

    def model_errors_n(self, unknown: Array) -> Array:
        """Error of every window's force by the model errors that are common to the sweeps, N."""
        force = self._forces.at(unknown).force[: self.windows]
        return np.asarray(force * (self.at_angle @ unknown[self.layout.of_errors]))

    def elastic(self, unknown: Array) -> Array:
        """d(force)/d(ln flow) of every window, N."""
        return self._forces.at(unknown).elastic


def _independent(unknown: Array, place: slice, mean: float, std_dev: float) -> _Term:
    """Of unknowns with the same mean and standard deviation."""
    values = unknown[place]
    jacobian = np.zeros((values.size, unknown.size))
    jacobian[:, place] = np.eye(values.size) / std_dev
    return (values - mean) / std_dev, jacobian


def _inverse(information: Array, unit: Array) -> Array:
    scaled_information = information * unit[:, None] * unit
    return np.asarray(np.linalg.inv(scaled_information)) * unit[:, None] * unit


def _impact_scale(values: Mapping[str, float]) -> float:
    return 1.0 if "restitution" in values else max(abs(values["k1"]), abs(values["k2"]), 1e-12)
