"""The closed loop as a least-squares problem.

Data are the sweeps' windows, the prior and weighed masses. The unknown vector holds the parameters (n), the logarithm of each
sweep's flow (S), the slope of each flow (S) if flows are linear in time, and the model's relative error at each plate angle (A)
if there are several sweeps, to which it is common. For a single sweep that error is counted as noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.clusters import cluster
from yieldmon.estimation.fitting.batch import MomentumBatch
from yieldmon.estimation.fitting.least_squares import levenberg_marquardt
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import Prior, physical_bounds, search_bounds
from yieldmon.physics.effects.other_monitor import BIAS
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .closed_loop_inputs import MeasuredDensity, Sweep, WeighedMass
from .flow_process import correlation, process_sd

_LEAST_FLOW_KG_S, _LARGEST_FLOW_KG_S = 1e-3, 1e3
_AT_END = 1e-6
"""Distance of ln(flow) from the least flow within which a search has ended there."""
_FOLLOWED = 1e-4
"""Relative size of a Newton step of the flows after which the remaining error is that of rounding."""
_NEWTON_STEPS = 4
_LARGEST_ERROR = 0.9
"""Largest relative error of the model at an angle."""
_LEAST_GAIN = 1e-8
"""Least decrease of chi-square for a further step, as of one by 1e-4 standard deviations."""


@dataclass(frozen=True, slots=True)
class _Forces:
    """Force of the windows (N,), its derivatives with respect to parameters (N, n) and flow (N,), and the flow (N,)."""

    force: Array
    by_theta: Array
    by_load: Array
    load: Array


@dataclass(frozen=True, slots=True)
class _WeighedFlows:
    """Flows that explain the forces of the weighed loads' windows (w,), their derivatives (w, n), and the parameters there
    (n,)."""

    flow: Array
    by_theta: Array
    theta: Array

    def at(self, theta: Array) -> Array:
        """Approximate flows with other parameters."""
        return np.clip(self.flow + self.by_theta @ (theta - self.theta), 0.5 * self.flow, 2.0 * self.flow)


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
    """

    unknown: Array
    residual: Array
    jacobian: Array
    covariance: Array
    whiteners: tuple[Array, ...]


@dataclass(frozen=True, slots=True)
class UnknownLayout:
    """Order of the unknown vector: parameters, ln flows, slopes of flows, model errors.

    Attributes
    ----------
    parameters, sweeps, slopes, errors : int
        Number of each; there is one flow for each sweep, and one slope for each or none.
    """

    parameters: int
    sweeps: int
    slopes: int
    errors: int

    @property
    def of_parameters(self) -> slice:
        """Place of the parameters."""
        return slice(0, self.parameters)

    @property
    def of_flows(self) -> slice:
        """Place of the logarithms of the flows."""
        return slice(self.parameters, self.parameters + self.sweeps)

    @property
    def of_slopes(self) -> slice:
        """Place of the flows' slopes."""
        return slice(self.of_flows.stop, self.of_flows.stop + self.slopes)

    @property
    def of_errors(self) -> slice:
        """Place of the model errors."""
        return slice(self.of_slopes.stop, self.of_slopes.stop + self.errors)


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
    flow_covariances : list of ndarray
        Covariance of each sweep's ln(flow) about its level, if the flow is a random process.
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
        self.rows = MomentumBatch(model, self._conditions(), self.names, self.fixed)
        forces = [s.force_n for s in self.sweeps] + [a.force_n for a in self.masses]
        self.force: Array = np.concatenate(forces) if forces else np.zeros(0)
        self.sweep_rows = _slices([s.force_n.size for s in self.sweeps])
        self.windows = sum(s.force_n.size for s in self.sweeps)
        self.weighed_rows = _slices([a.force_n.size for a in self.masses], self.windows)
        self.at_angle = self._angles_in_common()
        slopes = len(self.sweeps) if settings.flow == "linear" else 0
        self.layout = UnknownLayout(len(self.names), len(self.sweeps), slopes, self.at_angle.shape[1])
        self.clocks = [s.time_s - s.time_s.mean() for s in self.sweeps]
        self.flow_covariances: list[Array] = []
        self._near = _WeighedFlows(np.zeros(0), np.zeros((0, len(self.names))), self.prior.mean)
        """Flows of the weighed loads at the last evaluation."""
        self._last: tuple[bytes, _Forces] | None = None

    def _bounds(self, name: str, mean: float, *, weighed: bool) -> tuple[float, float]:
        """Limits of a parameter: the search range of calibrations for sweeps alone; the physical range if something was weighed
        or the prior's value lies outside the search range."""
        scale = _impact_scale(self.prior_set.values)
        low, high = search_bounds(name, scale)
        if weighed or not low <= mean <= high:
            low, high = physical_bounds(name, scale)
        return min(low, mean), max(high, mean)

    def _conditions(self) -> Conditions:
        parts: tuple[Sweep | WeighedMass, ...] = (*self.sweeps, *self.masses)
        if not parts:
            home = self.model.machine
            return Conditions(home.home_plate_angle_rad, home.nominal_elevator_speed_rad_s, mass_flow_kg_s=np.ones(1))
        needs_moisture = any(p.moisture_pct is not None for p in parts)
        moisture = [np.full(p.force_n.size, np.nan) if p.moisture_pct is None else p.moisture_pct for p in parts]
        return Conditions(
            np.concatenate([p.plate_angle_rad for p in parts]),
            np.concatenate([p.elevator_speed_rad_s for p in parts]),
            mass_flow_kg_s=np.ones(sum(p.force_n.size for p in parts)),
            moisture_pct=np.concatenate(moisture) if needs_moisture else None,
        )

    def _angles_in_common(self) -> Array:
        if len(self.sweeps) < 2 or self.settings.model_error == 0.0:
            return np.zeros((self.windows, 0))
        of_window = cluster(np.concatenate([s.plate_angle_rad for s in self.sweeps]), SAME_ANGLE_RAD)
        return np.asarray(of_window[:, None] == np.unique(of_window), dtype=float)

    def solve(self) -> Solution:
        """Find the most likely unknown. Raises ValueError if no flow can explain a sweep or a weighed load."""
        count, slopes, errors = self.layout.sweeps, self.layout.slopes, self.layout.errors
        flows, weighed_flows = self._first_flows()
        self._near = _WeighedFlows(weighed_flows, np.zeros((weighed_flows.size, self.layout.parameters)), self.prior.mean)
        unknown = np.concatenate((self.prior.mean, np.log(flows), np.zeros(slopes + errors)))
        least = np.full(count, np.log(_LEAST_FLOW_KG_S)), np.full(slopes, -1.0), np.full(errors, -_LARGEST_ERROR)
        most = np.full(count, np.log(_LARGEST_FLOW_KG_S)), np.full(slopes, 1.0), np.full(errors, _LARGEST_ERROR)
        low, high = np.concatenate((self.lower, *least)), np.concatenate((self.upper, *most))
        sizes = np.full(count, 0.1), np.full(slopes, 0.01), np.full(errors, self.settings.model_error)
        unit = np.concatenate((self.prior.standard_deviation, *sizes))
        # The noise by flow and model error depends on the solution, so both are computed alternately.
        passes = 3 if self.sweeps and (self.settings.flow == "process" or self.settings.model_error > 0.0) else 1
        for _ in range(passes):
            whiteners = self._whiteners(unknown)
            found = levenberg_marquardt(
                partial(self._search_residuals, whiteners),
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
        empty = np.flatnonzero(unknown[self.layout.of_flows] <= np.log(_LEAST_FLOW_KG_S) + _AT_END)
        if empty.size:
            raise ValueError(f"sweep {empty[0] + 1} of {count}: its forces are those of an empty machine, without a flow to find")
        jacobian = found.jacobian[0]
        return Solution(unknown, found.residual[0], jacobian, _inverse(jacobian.T @ jacobian, unit), tuple(whiteners))

    def _first_flows(self) -> tuple[Array, Array]:
        loop = OpenLoop(self.model, self.prior_set)
        flows = np.empty(len(self.sweeps))
        for i, sweep in enumerate(self.sweeps):
            # Large forces determine the flow best; the median over the larger half is robust against a bad window.
            order = np.argsort(sweep.force_n)[-max(1, sweep.force_n.size // 2) :]
            moisture = None if sweep.moisture_pct is None else sweep.moisture_pct[order]
            each = loop.invert(sweep.force_n[order], sweep.plate_angle_rad[order], sweep.elevator_speed_rad_s[order], moisture)
            each = each[np.isfinite(each) & (each > 0.0)]
            if not each.size:
                raise ValueError("no flow below a full paddle explains a sweep with the prior's parameters")
            flows[i] = np.median(each)
        weighed_flows = [loop.invert(a.force_n, a.plate_angle_rad, a.elevator_speed_rad_s, a.moisture_pct) for a in self.masses]
        together = np.concatenate(weighed_flows) if weighed_flows else np.zeros(0)
        if not np.all(np.isfinite(together)):
            raise ValueError("a weighed load holds more force than a full paddle gives with the prior's parameters")
        return flows, np.maximum(together, 1e-3)

    def _loads(self, unknown: Array, weighed_flows: Array) -> Array:
        level, slope = unknown[self.layout.of_flows], unknown[self.layout.of_slopes]
        parts = [
            np.exp(level[i] + (slope[i] * self.clocks[i] if slope.size else 0.0)) * np.ones(s.force_n.size)
            for i, s in enumerate(self.sweeps)
        ]
        return np.concatenate([*parts, weighed_flows]) if parts or weighed_flows.size else np.ones(1)

    def _forces(self, unknown: Array) -> _Forces:
        """Forces of the windows. Flows of the weighed loads are updated so that they explain their forces."""
        place = unknown.tobytes()
        if self._last is not None and self._last[0] == place:
            return self._last[1]
        if not self.sweeps and not self.masses:
            return _Forces(np.zeros(0), np.zeros((0, self.layout.parameters)), np.zeros(0), np.ones(1))
        theta, rows, passes = unknown[self.layout.of_parameters], slice(self.windows, None), self.rows.passes_per_s
        for _ in range(_NEWTON_STEPS):
            load = self._loads(unknown, self._near.at(theta))
            value, jacobian, by_load = self.rows.at_load(theta, load)
            found = _Forces(value * passes, jacobian * passes[:, None], by_load * passes, load)
            if not self.masses:
                break
            change = (self.force[rows] - found.force[rows]) / found.by_load[rows]
            if not np.all(np.isfinite(change)):
                # More than a full paddle: the flows cannot be updated.
                return found
            flow = np.clip(load[rows] + change, 0.5 * load[rows], 2.0 * load[rows])
            self._near = _WeighedFlows(flow, -found.by_theta[rows] / found.by_load[rows, None], theta)
            if np.max(np.abs(change)) <= _FOLLOWED * np.mean(flow):
                break
        self._last = place, found
        return found

    def _whiteners(self, unknown: Array) -> list[Array]:
        """Inverse of the lower Cholesky factor of each sweep's force covariance."""
        settings = self.settings
        own_error = 0.0 if self.at_angle.size else settings.model_error
        if not self.sweeps or (settings.flow != "process" and own_error == 0.0):
            return [np.diag(1.0 / sweep.force_std_dev_n) for sweep in self.sweeps]
        found = self._forces(unknown)
        force, by_load, loads = found.force, found.by_load, found.load
        out: list[Array] = []
        covariances: list[Array] = []
        for sweep, rows, clock in zip(self.sweeps, self.sweep_rows, self.clocks, strict=True):
            noise = np.diag(sweep.force_std_dev_n**2)
            if own_error > 0.0:
                lag = (sweep.plate_angle_rad[:, None] - sweep.plate_angle_rad) / SAME_ANGLE_RAD
                noise += own_error**2 * np.exp(-(lag**2)) * np.outer(force[rows], force[rows])
            if settings.flow == "process":
                elastic = by_load[rows] * loads[rows]
                sd = process_sd(
                    (sweep.force_n - force[rows]) / elastic,
                    sweep.force_std_dev_n / elastic,
                    sweep.plate_angle_rad,
                    clock,
                    settings.flow_process_time_s,
                    settings.flow_process_sd,
                )
                covariances.append(sd**2 * correlation(clock, settings.flow_process_time_s))
                noise += covariances[-1] * np.outer(elastic, elastic)
            out.append(np.linalg.inv(np.linalg.cholesky(noise)))
        self.flow_covariances = covariances
        return out

    def _search_residuals(self, whiteners: Sequence[Array], unknown: Array, _: NDArray[np.intp]) -> tuple[Array, Array]:
        return self._residuals(unknown[0], whiteners)

    def _residuals(self, unknown: Array, whiteners: Sequence[Array]) -> tuple[Array, Array]:
        """Whitened residuals (1, m) and derivatives (1, m, u) of windows, prior, slopes, model errors, masses and density."""
        layout = self.layout
        found = self._forces(unknown)
        force, by_theta, by_load, loads = found.force, found.by_theta, found.by_load, found.load
        residuals, jacobians = [], []
        errors = unknown[layout.of_errors]
        missed = self.model_errors_n(unknown)
        for i, (rows, whitener) in enumerate(zip(self.sweep_rows, whiteners, strict=True)):
            jacobian = np.zeros((len(whitener), unknown.size))
            factor = 1.0 + self.at_angle[rows] @ errors
            jacobian[:, layout.of_parameters] = by_theta[rows] * factor[:, None]
            jacobian[:, layout.of_errors] = self.at_angle[rows] * force[rows, None]
            elastic = by_load[rows] * loads[rows] * factor
            jacobian[:, layout.of_flows.start + i] = elastic
            if layout.slopes:
                jacobian[:, layout.of_slopes.start + i] = elastic * self.clocks[i]
            residuals.append(whitener @ (force[rows] + missed[rows] - self.force[rows]))
            jacobians.append(whitener @ jacobian)
        prior_jacobian = np.zeros((layout.parameters, unknown.size))
        prior_jacobian[:, layout.of_parameters] = self.white
        residuals.append(self.white @ (unknown[layout.of_parameters] - self.prior.mean))
        jacobians.append(prior_jacobian)
        if layout.slopes:
            slope_jacobian = np.zeros((layout.slopes, unknown.size))
            slope_jacobian[:, layout.of_slopes] = np.eye(layout.slopes) / self.settings.flow_slope_sd_per_s
            residuals.append(unknown[layout.of_slopes] / self.settings.flow_slope_sd_per_s)
            jacobians.append(slope_jacobian)
        if errors.size:
            error_jacobian = np.zeros((errors.size, unknown.size))
            error_jacobian[:, layout.of_errors] = np.eye(errors.size) / self.settings.model_error
            residuals.append(errors / self.settings.model_error)
            jacobians.append(error_jacobian)
        for mass, rows in zip(self.masses, self.weighed_rows, strict=True):
            # The last Newton step of the flows that explain the forces.
            flow = loads[rows] + (self.force[rows] - force[rows]) / by_load[rows]
            error_kg, sd_kg = float(mass.duration_s @ flow - mass.reference_kg), mass.std_dev_kg
            by = np.zeros((1, unknown.size))
            by[0, layout.of_parameters] = -(mass.duration_s / by_load[rows]) @ by_theta[rows]
            if mass.common_kg > 0.0 and BIAS in self.names:
                place = self.names.index(BIAS)
                error_kg -= mass.common_kg * unknown[place]
                by[0, place] -= mass.common_kg
                sd_kg = (sd_kg**2 - mass.common_kg**2) ** 0.5
            residuals.append(np.array([error_kg / sd_kg]))
            jacobians.append(by / sd_kg)
        if self.density is not None:
            index = self.names.index("density")
            by = np.zeros((1, unknown.size))
            by[0, index] = 1.0 / self.density.std_dev_kg_m3
            residuals.append(np.array([(unknown[index] - self.density.density_kg_m3) / self.density.std_dev_kg_m3]))
            jacobians.append(by)
        return np.concatenate(residuals)[None], np.vstack(jacobians)[None]

    def model_errors_n(self, unknown: Array) -> Array:
        """Error of every window's force by the model errors that are common to the sweeps, N."""
        return np.asarray(self._forces(unknown).force[: self.windows] * (self.at_angle @ unknown[self.layout.of_errors]))

    def elastic(self, unknown: Array) -> Array:
        """d(force)/d(ln flow) of every window, N."""
        found = self._forces(unknown)
        return found.by_load * found.load


def _inverse(information: Array, unit: Array) -> Array:
    scaled_information = information * unit[:, None] * unit
    return np.asarray(np.linalg.inv(scaled_information)) * unit[:, None] * unit


def _slices(sizes: Sequence[int], first: int = 0) -> list[slice]:
    ends = first + np.cumsum([0, *sizes])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def _impact_scale(values: Mapping[str, float]) -> float:
    return 1.0 if "restitution" in values else max(abs(values["k1"]), abs(values["k2"]), 1e-12)
