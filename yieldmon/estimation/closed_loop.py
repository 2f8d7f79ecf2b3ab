"""Closed loop: flow and parameters together from sweeps of the plate, with all that was known before.

A sweep leaves the scale (mass flow, density, impact gain) -> (a, a, 1/a) exactly unobservable, so the estimate is a maximum a
posteriori with the prior's full covariance, and what a sweep did not determine stays as it was. Shared parameters, one free flow
a sweep; weighed masses and a known density join as further measurements. Posterior by Laplace's approximation.

Sources: thesis section 9.3 for the idea of the sweep; Gelman et al., "Bayesian Data Analysis" (normal approximation of the
posterior); Schmidt, "Application of state-space methods to navigation problems" (1966), for keeping a parameter while its error
goes on counting.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .batch import MomentumBatch
from .closed_loop_settings import ClosedLoopSettings
from .flow_process import correlation, process_sd
from .identifiability import Direction, directions, flow_names, natural_scale, scale_tangent, scaled, share_flow
from .least_squares import levenberg_marquardt
from .open_loop import OpenLoop
from .parameters import ParameterSet
from .priors import Prior, physical_bounds


@dataclass(frozen=True)
class Sweep:
    """Windows of one sweep, all arrays (n,). time_s from any epoch. moisture_pct only where an effect needs it.

    Raises ValueError for shapes that differ, values that are not finite, or standard deviations that are not above 0.
    """

    time_s: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    force_n: Array
    force_std_dev_n: Array
    moisture_pct: Array | None = None

    def __post_init__(self) -> None:
        shape = self.force_n.shape
        for name in ("time_s", "plate_angle_rad", "elevator_speed_rad_s", "force_n", "force_std_dev_n"):
            value = getattr(self, name)
            if value.shape != shape or len(shape) != 1 or not shape[0] or not np.all(np.isfinite(value)):
                raise ValueError(f"sweep: {name} must hold one finite number for each window")
        if np.any(self.force_std_dev_n <= 0.0):
            raise ValueError("sweep: force_std_dev_n must be above 0")


@dataclass(frozen=True)
class MassAnchor:
    """A weighed mass and the windows in which it was harvested; all arrays (n,). std_dev_kg: the scale's."""

    reference_kg: float
    std_dev_kg: float
    duration_s: Array
    force_n: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    moisture_pct: Array | None = None

    @classmethod
    def from_windows(
        cls,
        reference_kg: float,
        std_dev_kg: float,
        duration_s: Array,
        force_n: Array,
        plate_angle_rad: Array,
        elevator_speed_rad_s: Array,
        *,
        groups: int = 12,
    ) -> MassAnchor:
        """Many windows condensed to `groups` at each plate angle: windows of like force are replaced by their mean."""
        bins = np.round(plate_angle_rad / np.radians(2.0)).astype(int)
        parts = []
        for value in np.unique(bins):
            here = np.flatnonzero(bins == value)
            order = here[np.argsort(force_n[here], kind="stable")]
            parts += [p for p in np.array_split(order, min(groups, order.size)) if duration_s[p].sum() > 0.0]
        weight = [duration_s[p] / duration_s[p].sum() for p in parts]

        def mean(column: Array) -> Array:
            return np.array([w @ column[p] for p, w in zip(parts, weight, strict=True)])

        return cls(
            reference_kg,
            std_dev_kg,
            np.array([duration_s[p].sum() for p in parts]),
            mean(force_n),
            mean(plate_angle_rad),
            mean(elevator_speed_rad_s),
        )

    @classmethod
    def from_total(
        cls,
        reference_kg: float,
        std_dev_kg: float,
        measured_kg: float,
        model: ForwardModel,
        parameters: ParameterSet,
        mass_flow_kg_s: float,
        plate_angle_rad: float,
        elevator_speed_rad_s: float,
    ) -> MassAnchor:
        """From a measured total alone: `parameters` made it, at about `mass_flow_kg_s`."""
        conditions = Conditions(plate_angle_rad, elevator_speed_rad_s, mass_flow_kg_s=mass_flow_kg_s)
        force = np.atleast_1d(np.real(model.force(conditions, parameters.values)))
        return cls(
            reference_kg,
            std_dev_kg,
            np.array([measured_kg / mass_flow_kg_s]),
            force,
            np.array([plate_angle_rad]),
            np.array([elevator_speed_rad_s]),
        )


@dataclass(frozen=True, slots=True)
class DensityAnchor:
    """A density measured otherwise, kg/m3, in the terms of the parameter `density`."""

    density_kg_m3: float
    std_dev_kg_m3: float

    @classmethod
    def from_test_weight(
        cls, test_weight_kg_m3: float, std_dev_kg_m3: float, ratio: float, ratio_std_dev: float
    ) -> DensityAnchor:
        """From a test weight. The fitted density is no test weight (it stands for the heap on a paddle): `ratio` = fitted
        density over test weight in a calibration, with its own standard deviation."""
        relative = np.hypot(std_dev_kg_m3 / test_weight_kg_m3, ratio_std_dev / ratio)
        return cls(ratio * test_weight_kg_m3, float(ratio * test_weight_kg_m3 * relative))


@dataclass(frozen=True, slots=True)
class FlowPosterior:
    """Mean mass flow of one sweep, kg/s; log_sd: standard deviation of its logarithm, parameters' uncertainty included."""

    mass_flow_kg_s: float
    log_sd: float

    @property
    def std_dev_kg_s(self) -> float:
        """Standard deviation, kg/s."""
        return self.mass_flow_kg_s * self.log_sd

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """Central interval, kg/s."""
        from scipy.special import ndtri

        reach = float(ndtri(0.5 + 0.5 * level)) * self.log_sd
        return self.mass_flow_kg_s * float(np.exp(-reach)), self.mass_flow_kg_s * float(np.exp(reach))


@dataclass(frozen=True, slots=True)
class Learning:
    """What became of one parameter. ratio: posterior over prior standard deviation. learned: value and variance moved."""

    name: str
    prior: float
    prior_sd: float
    value: float
    sd: float
    learned: bool

    @property
    def ratio(self) -> float:
        """Posterior over prior width."""
        return self.sd / self.prior_sd

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """Central interval."""
        from scipy.special import ndtri

        reach = float(ndtri(0.5 + 0.5 * level)) * self.sd
        return self.value - reach, self.value + reach


@dataclass(frozen=True, slots=True)
class ScaleReport:
    """The direction (mass flow, density, impact gain) -> (a, a, 1/a).

    prior_sd, posterior_sd of ln a; shift: ln a from the prior to the answer. observable: whether something other than the prior
    (an anchor, an effect that breaks the symmetry) speaks of it.
    """

    prior_sd: float
    posterior_sd: float
    shift: float
    observable: bool
    unobservable_directions: tuple[Direction, ...]
    """Found numerically from the sweeps alone, whatever they may be."""

    @property
    def ratio(self) -> float:
        """Posterior over prior width."""
        return self.posterior_sd / self.prior_sd if self.prior_sd > 0.0 else float("nan")


@dataclass(frozen=True)
class Outcome:
    """The result of `self_calibrate`. parameter_set: the one to use from now on (the prior's own where updated is False)."""

    parameter_set: ParameterSet
    updated: bool
    consistent: bool
    """Whether the misfit is no more than noise and model error explain; if not, nothing is updated."""
    reason: str
    """One sentence for the operator."""
    region: str
    """Where the sweeps' misfit is largest."""
    flows: tuple[FlowPosterior, ...]
    parameters: tuple[Learning, ...]
    scale: ScaleReport
    chi2: float
    dof: int
    p_value: float
    residuals: tuple[Array, ...] = field(repr=False)
    """Of each sweep, N: measured less predicted force, in the order of its windows."""
    prior_widening: float = 1.0
    """What `update_from_tickets` multiplied the prior's covariance by before it agreed with the weighed masses."""

    def learned(self) -> tuple[str, ...]:
        """Names of the parameters that moved."""
        return tuple(p.name for p in self.parameters if p.learned)


class SelfCalibrator:
    """`self_calibrate` with its model and settings kept; holds no other state."""

    def __init__(self, model: ForwardModel, settings: ClosedLoopSettings | None = None) -> None:
        self.model = model
        self.settings = ClosedLoopSettings() if settings is None else settings

    def update(
        self,
        prior: ParameterSet,
        sweeps: Sequence[Sweep],
        anchors: Sequence[MassAnchor] = (),
        density: DensityAnchor | None = None,
    ) -> Outcome:
        """See `self_calibrate`."""
        return self_calibrate(self.model, prior, sweeps, anchors=anchors, density=density, settings=self.settings)


def self_calibrate(
    model: ForwardModel,
    prior: ParameterSet,
    sweeps: Sequence[Sweep],
    *,
    anchors: Sequence[MassAnchor] = (),
    density: DensityAnchor | None = None,
    settings: ClosedLoopSettings | None = None,
) -> Outcome:
    """Flows of the sweeps and updated parameters. The parameters in question are those with a variance in `prior`.

    The update is refused whole when the misfit is too large, and in part where the data say next to nothing: see
    ClosedLoopSettings.learned_information and kept_ratio. Raises ValueError when there is nothing to go by, the prior has no
    covariance, or no flow can explain a sweep.
    """
    problem = _Problem(model, prior, sweeps, anchors, density, ClosedLoopSettings() if settings is None else settings)
    return problem.solve()


_WIDENINGS = 4
_ALL = 1e-9
"""So little information of a weighed mass counts for something."""
_NARROWED = 0.995


def update_from_tickets(
    model: ForwardModel,
    prior: ParameterSet,
    anchors: Sequence[MassAnchor],
    density: DensityAnchor | None = None,
    settings: ClosedLoopSettings | None = None,
) -> Outcome:
    """`self_calibrate` from weighed masses alone. A scale counts: where it contradicts the parameters, they were less
    certain than they claimed, and their standard deviations are doubled until both agree, up to 16 times. However little a
    weighed mass says beside those before it, it is taken: unlike a sweep it has no error that comes back the same each time.
    Raises as `self_calibrate`.
    """
    widening = 1.0
    settings = replace(ClosedLoopSettings() if settings is None else settings, learned_information=_ALL, kept_ratio=1.0 - _ALL)
    outcome = self_calibrate(model, prior, (), anchors=anchors, density=density, settings=settings)
    for _ in range(_WIDENINGS):
        if outcome.consistent:
            break
        widening *= 4.0
        wide = replace(prior, covariance=widening * prior.covariance)
        outcome = self_calibrate(model, wide, (), anchors=anchors, density=density, settings=settings)
    return replace(outcome, prior_widening=widening)


@dataclass(frozen=True, slots=True)
class _Forces:
    """Force (N,) of the windows, by the parameters (N, n), by the load (N,), and the load itself (N,)."""

    force: Array
    by_theta: Array
    by_load: Array
    load: Array


@dataclass(frozen=True, slots=True)
class _AnchorFlows:
    """Flows (A,) that explain the forces of the weighed loads' windows with some parameters (n,), and by_theta (A, n) there."""

    flow: Array
    by_theta: Array
    theta: Array

    def at(self, theta: Array) -> Array:
        """About those with other parameters."""
        return np.clip(self.flow + self.by_theta @ (theta - self.theta), 0.5 * self.flow, 2.0 * self.flow)


_FOLLOWED = 1e-4
"""A Newton step of the flows this small leaves an error at rounding, their curvature being of their own size."""
_NEWTON_STEPS = 4
_LEAST_GAIN = 1e-8
"""Of chi-square, that a further step is worth: one of 1e-4 standard deviations."""


class _Problem:
    def __init__(
        self,
        model: ForwardModel,
        prior: ParameterSet,
        sweeps: Sequence[Sweep],
        anchors: Sequence[MassAnchor],
        density: DensityAnchor | None,
        settings: ClosedLoopSettings,
    ) -> None:
        if set(prior.effects) != set(model.effects):
            raise ValueError(f"parameters speak of effects {prior.effects}; the model has {model.effects}")
        if not sweeps and not anchors and density is None:
            raise ValueError("neither a sweep nor an anchor to learn from")
        self.model, self.prior_set, self.sweeps, self.anchors = model, prior, tuple(sweeps), tuple(anchors)
        self.settings = settings
        self.prior = Prior.of(prior)
        self.names = self.prior.names
        if not self.names:
            raise ValueError("the parameters have no covariance: every one of them counts as exactly known")
        if density is not None and "density" not in self.names:
            raise ValueError("a density anchor needs density among the parameters with a variance")
        self.density = density
        self.white, _ = self.prior.whitening(self.names)
        self.fixed = {k: v for k, v in prior.values.items() if k not in self.names}
        scale = self._impact_scale(prior.values)
        limits = [physical_bounds(n, scale) for n in self.names]
        self.lower = np.array([min(lo, m) for (lo, _), m in zip(limits, self.prior.mean, strict=True)])
        self.upper = np.array([max(hi, m) for (_, hi), m in zip(limits, self.prior.mean, strict=True)])
        self.rows = MomentumBatch(model, self._conditions(), self.names, self.fixed)
        forces = [s.force_n for s in self.sweeps] + [a.force_n for a in self.anchors]
        self.force: Array = np.concatenate(forces) if forces else np.zeros(0)
        self.sweep_rows = _slices([s.force_n.size for s in self.sweeps])
        self.anchor_rows = _slices([a.force_n.size for a in self.anchors], sum(s.force_n.size for s in self.sweeps))
        self.tail = sum(s.force_n.size for s in self.sweeps)
        self.slopes = len(self.sweeps) if settings.flow == "linear" else 0
        self.clocks = [s.time_s - s.time_s.mean() for s in self.sweeps]
        self.flow_covariances: list[Array] = []
        self._near = _AnchorFlows(np.zeros(0), np.zeros((0, len(self.names))), self.prior.mean)
        """Where the weighed loads were evaluated last."""
        self._last: tuple[bytes, _Forces] | None = None

    @staticmethod
    def _impact_scale(values: Mapping[str, float]) -> float:
        return 1.0 if "restitution" in values else max(abs(values["k1"]), abs(values["k2"]), 1e-12)

    def _conditions(self) -> Conditions:
        parts: tuple[Sweep | MassAnchor, ...] = (*self.sweeps, *self.anchors)
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

    def solve(self) -> Outcome:
        count, width = len(self.sweeps), len(self.names)
        flows, anchor_flows = self._first_flows()
        self._near = _AnchorFlows(anchor_flows, np.zeros((anchor_flows.size, width)), self.prior.mean)
        unknown = np.concatenate((self.prior.mean, np.log(flows), np.zeros(self.slopes)))
        low = np.concatenate((self.lower, np.full(count, np.log(1e-3)), np.full(self.slopes, -1.0)))
        high = np.concatenate((self.upper, np.full(count, np.log(1e3)), np.full(self.slopes, 1.0)))
        unit = np.concatenate((self.prior.standard_deviation, np.full(count, 0.1), np.full(self.slopes, 0.01)))
        # Noise from flow and model error scales with the force's slope: settle both in turn.
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
                least_gain=_LEAST_GAIN if self.anchors else 0.0,
                learns_curvature=bool(self.anchors),
            )
            if not np.isfinite(found.cost[0]):
                raise ValueError("no flow below a full paddle explains a sweep with the prior's parameters")
            moved = float(np.max(np.abs(found.theta[0] - unknown) / unit))
            unknown = found.theta[0]
            if moved < 0.05:
                break
        return self._outcome(unknown, found.residual[0], found.jacobian[0], whiteners, width, count)

    def _first_flows(self) -> tuple[Array, Array]:
        loop = OpenLoop(self.model, self.prior_set)
        flows = np.empty(len(self.sweeps))
        for i, sweep in enumerate(self.sweeps):
            # The largest force determines it best; a median over the sweep's better half stands up to a bad window.
            order = np.argsort(sweep.force_n)[-max(1, sweep.force_n.size // 2) :]
            moisture = None if sweep.moisture_pct is None else sweep.moisture_pct[order]
            each = loop.invert(sweep.force_n[order], sweep.plate_angle_rad[order], sweep.elevator_speed_rad_s[order], moisture)
            each = each[np.isfinite(each) & (each > 0.0)]
            if not each.size:
                raise ValueError("no flow below a full paddle explains a sweep with the prior's parameters")
            flows[i] = np.median(each)
        anchor_flows = [loop.invert(a.force_n, a.plate_angle_rad, a.elevator_speed_rad_s, a.moisture_pct) for a in self.anchors]
        together = np.concatenate(anchor_flows) if anchor_flows else np.zeros(0)
        if not np.all(np.isfinite(together)):
            raise ValueError("a weighed load holds more force than a full paddle gives with the prior's parameters")
        return flows, np.maximum(together, 1e-3)

    def _loads(self, unknown: Array, anchor_flows: Array) -> Array:
        width, count = len(self.names), len(self.sweeps)
        level = unknown[width : width + count]
        slope = unknown[width + count :]
        parts = [
            np.exp(level[i] + (slope[i] * self.clocks[i] if self.slopes else 0.0)) * np.ones(s.force_n.size)
            for i, s in enumerate(self.sweeps)
        ]
        return np.concatenate([*parts, anchor_flows]) if parts or anchor_flows.size else np.ones(1)

    def _forces(self, unknown: Array) -> _Forces:
        """With the weighed loads at flows that explain their forces; these are followed from one evaluation to the next."""
        width, place = len(self.names), unknown.tobytes()
        if self._last is not None and self._last[0] == place:
            return self._last[1]
        if not self.sweeps and not self.anchors:
            return _Forces(np.zeros(0), np.zeros((0, width)), np.zeros(0), np.ones(1))
        theta, rows, passes = unknown[:width], slice(self.tail, None), self.rows.passes_per_s
        for _ in range(_NEWTON_STEPS):
            load = self._loads(unknown, self._near.at(theta))
            value, jacobian, by_load = self.rows.at_load(theta, load)
            found = _Forces(value * passes, jacobian * passes[:, None], by_load * passes, load)
            if not self.anchors:
                break
            change = (self.force[rows] - found.force[rows]) / found.by_load[rows]
            if not np.all(np.isfinite(change)):
                # More than a full paddle: nothing to follow.
                return found
            flow = np.clip(load[rows] + change, 0.5 * load[rows], 2.0 * load[rows])
            self._near = _AnchorFlows(flow, -found.by_theta[rows] / found.by_load[rows, None], theta)
            if np.max(np.abs(change)) <= _FOLLOWED * np.mean(flow):
                break
        self._last = place, found
        return found

    def _whiteners(self, unknown: Array) -> list[Array]:
        """Inverse of the lower Cholesky factor of each sweep's force covariance."""
        settings = self.settings
        if not self.sweeps or (settings.flow != "process" and settings.model_error == 0.0):
            return [np.diag(1.0 / sweep.force_std_dev_n) for sweep in self.sweeps]
        found = self._forces(unknown)
        force, by_load, loads = found.force, found.by_load, found.load
        out: list[Array] = []
        covariances: list[Array] = []
        for sweep, rows, clock in zip(self.sweeps, self.sweep_rows, self.clocks, strict=True):
            noise = np.diag(sweep.force_std_dev_n**2)
            if settings.model_error > 0.0:
                lag = (sweep.plate_angle_rad[:, None] - sweep.plate_angle_rad) / SAME_ANGLE_RAD
                noise += settings.model_error**2 * np.exp(-(lag**2)) * np.outer(force[rows], force[rows])
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
        """(1, m) and (1, m, n + S + slopes): windows, prior, slopes' prior, anchors; whitened."""
        width, count = len(self.names), len(self.sweeps)
        found = self._forces(unknown)
        force, by_theta, by_load, loads = found.force, found.by_theta, found.by_load, found.load
        residuals, jacobians = [], []
        for i, (rows, whitener) in enumerate(zip(self.sweep_rows, whiteners, strict=True)):
            jacobian = np.zeros((len(whitener), unknown.size))
            jacobian[:, :width] = by_theta[rows]
            elastic = by_load[rows] * loads[rows]
            jacobian[:, width + i] = elastic
            if self.slopes:
                jacobian[:, width + count + i] = elastic * self.clocks[i]
            residuals.append(whitener @ (force[rows] - self.force[rows]))
            jacobians.append(whitener @ jacobian)
        prior_jacobian = np.zeros((width, unknown.size))
        prior_jacobian[:, :width] = self.white
        residuals.append(self.white @ (unknown[:width] - self.prior.mean))
        jacobians.append(prior_jacobian)
        if self.slopes:
            slope_jacobian = np.zeros((self.slopes, unknown.size))
            slope_jacobian[:, width + count :] = np.eye(self.slopes) / self.settings.flow_slope_sd_per_s
            residuals.append(unknown[width + count :] / self.settings.flow_slope_sd_per_s)
            jacobians.append(slope_jacobian)
        for anchor, rows in zip(self.anchors, self.anchor_rows, strict=True):
            # The last of the Newton steps to the flows that explain the forces.
            flow = loads[rows] + (self.force[rows] - force[rows]) / by_load[rows]
            by = np.zeros((1, unknown.size))
            by[0, :width] = -(anchor.duration_s / by_load[rows]) @ by_theta[rows] / anchor.std_dev_kg
            residuals.append(np.array([(anchor.duration_s @ flow - anchor.reference_kg) / anchor.std_dev_kg]))
            jacobians.append(by)
        if self.density is not None:
            index = self.names.index("density")
            by = np.zeros((1, unknown.size))
            by[0, index] = 1.0 / self.density.std_dev_kg_m3
            residuals.append(np.array([(unknown[index] - self.density.density_kg_m3) / self.density.std_dev_kg_m3]))
            jacobians.append(by)
        return np.concatenate(residuals)[None], np.vstack(jacobians)[None]

    def _outcome(
        self, unknown: Array, residual: Array, jacobian: Array, whiteners: Sequence[Array], width: int, count: int
    ) -> Outcome:
        from scipy.special import chdtrc

        inverse = _inverse(
            jacobian.T @ jacobian,
            np.concatenate((self.prior.standard_deviation, np.full(count, 0.1), np.full(self.slopes, 0.01))),
        )
        theta, posterior = unknown[:width], inverse[:width, :width]
        information = self._data_information(jacobian, width, count)
        chi2 = float(residual @ residual)
        windows = sum(s.force_n.size for s in self.sweeps)
        dof = max(windows + len(self.anchors) + (self.density is not None) - count, 1)
        p_value = float(chdtrc(dof, chi2))
        kept_theta, kept_cov = self._refuse(theta, information)
        prior_sd = self.prior.standard_deviation
        moved = kept_cov is not None
        consistent = p_value >= self.settings.consistent_p
        new_theta = kept_theta
        new_cov = self.prior.covariance if kept_cov is None else kept_cov
        sds = np.sqrt(np.diag(new_cov))
        changed = [moved and not (new_theta[i] == self.prior.mean[i] and sds[i] == prior_sd[i]) for i in range(width)]
        updated = consistent and any(changed)
        learning = tuple(
            Learning(
                n,
                float(self.prior.mean[i]),
                float(prior_sd[i]),
                float(new_theta[i]) if consistent else float(self.prior.mean[i]),
                float(sds[i]) if consistent else float(prior_sd[i]),
                updated and changed[i],
            )
            for i, n in enumerate(self.names)
        )
        if updated:
            values = dict(self.prior_set.values) | {n: float(v) for n, v in zip(self.names, new_theta, strict=True)}
            parameter_set = replace(
                self.prior_set,
                values=values,
                covariance_names=self.names,
                covariance=new_cov,
                version=self.prior_set.version + 1,
            )
        else:
            parameter_set = self.prior_set
        whitened = _split(residual[:windows], self.sweep_rows)
        plain: tuple[Array, ...] = tuple(np.asarray(-np.linalg.solve(w, r)) for w, r in zip(whiteners, whitened, strict=True))
        scale = self._scale(theta, posterior, jacobian, width)
        return Outcome(
            parameter_set,
            updated,
            consistent,
            self._reason(updated, consistent, learning, p_value, plain, scale),
            self._worst_angle(plain),
            self._flows(unknown, inverse, residual, jacobian, whiteners, width),
            learning,
            scale,
            chi2,
            dof,
            p_value,
            plain,
        )

    def _data_information(self, jacobian: Array, width: int, count: int) -> Array:
        """Information on the parameters from everything but the prior, the flows projected out."""
        windows = sum(s.force_n.size for s in self.sweeps)
        data = np.delete(jacobian, slice(windows, windows + width), axis=0)
        full = data.T @ data
        info = full[:width, :width]
        if count:
            cross, block = full[:width, width:], full[width:, width:]
            info = info - cross @ np.linalg.solve(block, cross.T)
        return 0.5 * (info + info.T)

    def _refuse(self, theta: Array, information: Array) -> tuple[Array, Array | None]:
        """Mean and covariance after leaving out what was not learned; covariance None where nothing was."""
        prior = self.prior
        root = np.linalg.inv(self.white)
        values, vectors = np.linalg.eigh(root.T @ information @ root)
        values = np.maximum(values, 0.0)
        used = values >= self.settings.learned_information
        if not np.any(used):
            return prior.mean, None
        kept = vectors[:, used]
        # Whitened: prior covariance 1, so data information is the eigenvalues.
        step = root @ kept @ (kept.T @ (self.white @ (theta - prior.mean)))
        gain = root @ kept @ np.diag(values[used] / (1.0 + values[used])) @ kept.T @ self.white
        joint = root @ (np.eye(theta.size) - kept @ np.diag(values[used] / (1.0 + values[used])) @ kept.T) @ root.T
        shrunk = np.sqrt(np.diag(joint)) / prior.standard_deviation < self.settings.kept_ratio
        if not np.any(shrunk):
            return prior.mean, None
        # Schmidt: the kept parameters have no gain of their own, and their error goes on counting in the others'.
        gain = np.where(shrunk[:, None], gain, 0.0)
        noise = joint @ (self.white.T @ kept @ np.diag(values[used]) @ kept.T @ self.white) @ joint
        left = np.eye(theta.size) - gain
        covariance = left @ prior.covariance @ left.T + np.where(np.outer(shrunk, shrunk), noise, 0.0)
        covariance = 0.5 * (covariance + covariance.T)
        mean = np.where(shrunk, prior.mean + step, prior.mean)
        still = np.outer(~shrunk, ~shrunk)
        # The search kept theta within the physical bounds; the part of its step that is used may end a little beyond them.
        return np.clip(mean, self.lower, self.upper), np.where(still, prior.covariance, covariance)

    def _scale(self, theta: Array, posterior: Array, jacobian: Array, width: int) -> ScaleReport:
        values = {n: float(v) for n, v in zip(self.names, theta, strict=True)} | self.fixed
        tangent = np.array([scale_tangent(n, values[n]) for n in self.names])
        # ln a along the direction: the component of the change in the metric of the prior.
        metric = self.white.T @ self.white
        size = float(tangent @ metric @ tangent)
        if size <= 0.0:
            return ScaleReport(0.0, 0.0, 0.0, False, ())
        row = tangent @ metric / size
        prior_sd = float(np.sqrt(row @ self.prior.covariance @ row))
        posterior_sd = float(np.sqrt(row @ posterior @ row))
        shift = float(row @ (theta - self.prior.mean))
        found = self._null_directions(jacobian, values, width)
        breaks = bool(self.anchors) or self.density is not None or not any(d.is_scale for d in found)
        return ScaleReport(prior_sd, posterior_sd, shift, breaks, found)

    def _null_directions(self, jacobian: Array, values: Mapping[str, float], width: int) -> tuple[Direction, ...]:
        if not self.sweeps:
            return ()
        count = len(self.sweeps)
        relative = jacobian[: self.tail, :width] * np.array([natural_scale(n, values[n]) for n in self.names])
        together = np.column_stack((jacobian[: self.tail, width : width + count], relative))
        found = directions(together, flow_names(count, self.names))
        return share_flow([d for d in found if not np.isfinite(d.relative_sd)], count, self.names)

    def _flows(
        self, unknown: Array, inverse: Array, residual: Array, jacobian: Array, whiteners: Sequence[Array], width: int
    ) -> tuple[FlowPosterior, ...]:
        out = []
        for i, rows in enumerate(self.sweep_rows):
            level = float(unknown[width + i])
            gradient = np.zeros(unknown.size)
            gradient[width + i] = 1.0
            extra = 0.0
            if self.settings.flow == "process":
                # The process given the residuals; it moves against the level, so both count together.
                covariance = self.flow_covariances[i]
                gain = whiteners[i] @ (self._elastic(unknown)[rows, None] * covariance)
                level -= float((gain.T @ residual[rows]).mean())
                gradient -= gain.mean(axis=1) @ jacobian[rows]
                extra = float((covariance - gain.T @ gain).mean())
            variance = float(gradient @ inverse @ gradient) + max(extra, 0.0)
            out.append(FlowPosterior(float(np.exp(level)), float(np.sqrt(variance))))
        return tuple(out)

    def _elastic(self, unknown: Array) -> Array:
        """d(force)/d(ln flow) of every window."""
        found = self._forces(unknown)
        return found.by_load * found.load

    def _reason(
        self,
        updated: bool,
        consistent: bool,
        learning: Sequence[Learning],
        p_value: float,
        residuals: Sequence[Array],
        scale: ScaleReport,
    ) -> str:
        if not consistent:
            return (
                f"the windows disagree with the model (p = {p_value:.1g}), most around {self._worst_angle(residuals)}; "
                "the parameters stay"
            )
        if not updated:
            return "the data say too little beside what was known; the parameters stay"
        narrowed = ", ".join(f"{p.name} to {100.0 * p.ratio:.0f} %" for p in learning if p.learned and p.ratio < _NARROWED)
        if not narrowed:
            return "agrees with what was known, which it leaves about as certain"
        end = "" if scale.observable else "; the scale (flow, density, 1/impact gain) rests on the prior"
        return f"width narrowed: {narrowed}{end}"

    def _worst_angle(self, residuals: Sequence[Array]) -> str:
        angle = np.degrees(np.concatenate([s.plate_angle_rad for s in self.sweeps])) if self.sweeps else np.zeros(0)
        if not angle.size:
            return "the weighed loads"
        error = np.concatenate(residuals) / np.concatenate([s.force_std_dev_n for s in self.sweeps])
        sums = {a: abs(error[np.round(angle) == a].sum()) for a in np.unique(np.round(angle))}
        return f"{max(sums, key=lambda a: sums[a]):.0f} deg"


def _inverse(information: Array, unit: Array) -> Array:
    scaled_information = information * unit[:, None] * unit
    return np.asarray(np.linalg.inv(scaled_information)) * unit[:, None] * unit


def _slices(sizes: Sequence[int], first: int = 0) -> list[slice]:
    ends = first + np.cumsum([0, *sizes])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def _split(values: Array, rows: Sequence[slice]) -> list[Array]:
    return [values[r] for r in rows]


__all__ = [
    "ClosedLoopSettings",
    "DensityAnchor",
    "FlowPosterior",
    "Learning",
    "MassAnchor",
    "Outcome",
    "ScaleReport",
    "SelfCalibrator",
    "Sweep",
    "scaled",
    "self_calibrate",
    "update_from_tickets",
]
