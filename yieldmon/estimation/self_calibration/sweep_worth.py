"""Expected benefit of a sweep: the standard deviation of the flow after a sweep, and after the same time at home.

The sweep is linearised about the parameters in use and evaluated as in the closed loop: with a varying flow, one model error for
each plate angle, and only the part of the update that `partial_update.determined_part` keeps. The flow during the sweep is
unknown. The flow at home is then computed from the mean force, with the parameters' uncertainty, and from the pulses' shape and
kernel noise.

Source: expected information of an experiment, Lindley, Ann. Math. Statist. 27 (1956).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite, sqrt

import numpy as np

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.clusters import cluster
from yieldmon.estimation.fitting.batch import MomentumBatch
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import Prior
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .flow_process import correlation
from .partial_update import determined_part

_UNKNOWN_FLOW = 1e2
"""Prior variance of ln(flow), so large that the prior has no effect."""
_MOVING_S = 2.0
"""Approximate time of the plate from one stop to the next, until its feedback and the signal have settled."""
_LEAST_SD = 1e-3
"""Least relative standard deviation of a mean force or a channel."""


@dataclass(frozen=True, slots=True)
class SweepPlan:
    """A possible sweep and the present harvesting conditions.

    Attributes
    ----------
    time_s, plate_angle_rad : ndarray (m,)
        Of its windows.
    home_angle_rad : float
    elevator_speed_rad_s, mass_flow_kg_s : float
        Present values.
    noise_sd : float
        Relative standard deviation of one window's mean force.
    moisture_pct : float
        nan if it is not known.
    """

    time_s: Array
    plate_angle_rad: Array
    home_angle_rad: float
    elevator_speed_rad_s: float
    mass_flow_kg_s: float
    noise_sd: float
    moisture_pct: float


@dataclass(frozen=True, slots=True)
class OtherChannels:
    """Other measurements of the flow at home than the mean force.

    Attributes
    ----------
    shape_sd : float
        Relative standard deviation of the volume flow from the pulses' shape, without what averages out; inf if there is none.
    kernels_sd : float
        Relative standard deviation of the bias of the flow from kernel noise; inf if there is none.
    kernels_cross : tuple of float
        Covariance of that bias's logarithm with the parameters, in the order of their covariance; () if there is none.
    """

    shape_sd: float = inf
    kernels_sd: float = inf
    kernels_cross: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class SweepWorth:
    """Relative standard deviation of the flow at home after the plan's duration at home, and after its sweep."""

    at_home_sd: float
    with_sweep_sd: float

    @property
    def ratio(self) -> float:
        """at_home_sd / with_sweep_sd."""
        return self.at_home_sd / self.with_sweep_sd


def window_times_s(stops: Sequence[float]) -> Array:
    """Times of the 1 s windows of a sweep, s. stops: plate angle of each window; between different angles the plate moves."""
    moved = np.concatenate(([0.0], (np.diff(stops) != 0.0) * _MOVING_S))
    return np.asarray(np.cumsum(1.0 + moved))


def sweep_worth(
    model: ForwardModel, known: ParameterSet, plan: SweepPlan, channels: OtherChannels, settings: ClosedLoopSettings
) -> SweepWorth | None:
    """Compute the benefit of a sweep.

    Parameters
    ----------
    model : ForwardModel
    known : ParameterSet
        Present parameters, with the effect `angle_pattern` if it is estimated.
    plan : SweepPlan
    channels : OtherChannels
        Used both with and without the sweep.
    settings : ClosedLoopSettings
        With which the sweep would be evaluated.

    Returns
    -------
    SweepWorth or None
        None if the parameters have no variance, or the model gives no force at these conditions.
    """
    prior = Prior.of(known)
    names = prior.names
    if not names:
        return None
    home = np.append(plan.plate_angle_rad, plan.home_angle_rad)
    moisture = plan.moisture_pct if isfinite(plan.moisture_pct) else None
    conditions = Conditions(home, plan.elevator_speed_rad_s, mass_flow_kg_s=plan.mass_flow_kg_s, moisture_pct=moisture)
    fixed = {name: value for name, value in known.values.items() if name not in names}
    batch = MomentumBatch(model, conditions, names, fixed)
    force, by_parameter, by_load = batch.at_load(np.array([known.values[name] for name in names]), batch.load)
    if not np.all(np.isfinite(force)) or np.any(force <= 0.0):
        return None
    slopes, exponents = by_parameter / force[:, None], by_load * batch.load / force
    if not (np.all(np.isfinite(slopes)) and np.all(exponents > 0.0)):
        return None
    information = _information(plan, slopes[:-1], exponents[:-1], settings)
    limits = np.full(len(names), inf)
    _, after = determined_part(prior, prior.mean, information, -limits, limits, settings)
    mean_force = np.array([exponents[-1], *slopes[-1], 0.0])
    return SweepWorth(*(_flow_sd(prior, covariance, mean_force, plan, channels) for covariance in (prior.covariance, after)))


def _information(plan: SweepPlan, slopes: Array, exponents: Array, settings: ClosedLoopSettings) -> Array:
    """Information of ln(force) of the sweep's windows on the parameters, (n, n), with the flow's level eliminated."""
    group = cluster(plan.plate_angle_rad, SAME_ANGLE_RAD)
    same_angle = group[:, None] == group
    spread = plan.noise_sd**2 * np.eye(exponents.size) + settings.model_error**2 * same_angle
    if settings.flow == "process":
        wandering = correlation(plan.time_s, settings.flow_process_time_s)
        spread = spread + settings.flow_process_sd**2 * np.outer(exponents, exponents) * wandering
    lower = np.linalg.cholesky(spread + _LEAST_SD**2 * np.eye(exponents.size))
    unknown = [exponents]
    if settings.flow == "linear":
        unknown.append(exponents * (plan.time_s - plan.time_s.mean()))
    white, of_flow = (np.linalg.solve(lower, columns) for columns in (slopes, np.column_stack(unknown)))
    basis = np.linalg.qr(of_flow)[0]
    left = white - basis @ (basis.T @ white)
    return np.asarray(left.T @ left)


def _flow_sd(prior: Prior, after: Array, mean_force: Array, plan: SweepPlan, channels: OtherChannels) -> float:
    """Standard deviation of ln(flow) at home with a covariance of the parameters.

    after: covariance of the parameters, (n, n); the bias of kernel noise is updated with it. mean_force: derivatives of ln(mean
    force) with respect to ln(flow), parameters and bias, (n + 2,).
    """
    names, before, count = prior.names, prior.covariance, len(prior.names)
    states = np.zeros((count + 2, count + 2))
    states[0, 0] = _UNKNOWN_FLOW
    states[1:-1, 1:-1] = after
    rows, variances = [mean_force], [plan.noise_sd**2 / plan.time_s.size + _LEAST_SD**2]
    if isfinite(channels.shape_sd):
        row = np.zeros(count + 2)
        row[0] = 1.0
        if "density" in names:
            place = names.index("density")
            row[1 + place] = -1.0 / prior.mean[place]
        rows.append(row)
        variances.append(channels.shape_sd**2)
    if isfinite(channels.kernels_sd):
        states[-1, -1] = channels.kernels_sd**2
        if len(channels.kernels_cross) == count:
            size = np.sqrt(np.maximum(np.diag(before), 1e-300))
            cross = np.array(channels.kernels_cross)
            gain = np.linalg.lstsq(before / np.outer(size, size), cross / size, rcond=1e-12)[0] / size
            states[-1, 1:-1] = states[1:-1, -1] = gain @ after
            states[-1, -1] = max(channels.kernels_sd**2 - float(gain @ (before - after) @ gain), _LEAST_SD**2)
        row = np.zeros(count + 2)
        row[0] = row[-1] = 1.0
        rows.append(row)
        variances.append(_LEAST_SD**2)
    seen = np.array(rows)
    across = states @ seen.T
    posterior = states[0, 0] - across[0] @ np.linalg.solve(seen @ across + np.diag(variances), across[0])
    return sqrt(max(float(posterior), _LEAST_SD**2))
