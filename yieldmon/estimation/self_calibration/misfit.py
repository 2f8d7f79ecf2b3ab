"""Test whether several sweeps have residuals in common that the model cannot explain, and at which plate angles.

Residuals of a single sweep may come from a disturbance; the same pattern in several sweeps indicates an error of the model. The
residuals are averaged over the sweeps at each plate angle. The ratio of their mean square to that expected from the sweeps'
scatter and a tolerated model error is an F statistic. The reported region is the contiguous range of angles with the largest
normalised sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.clusters import cluster
from yieldmon.estimation.fitting.least_squares import levenberg_marquardt
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import search_bounds
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .sweep_flow import SweepWindows, window_flows
from .sweep_flow import force_n as model_force_n

_FREE = ("friction", "density")
_MOST_LOG_GAIN = 2.0
"""Largest change of the logarithm of the impact gain."""


@dataclass(frozen=True, slots=True)
class SweepResiduals:
    """Residuals of one sweep after a fit.

    Attributes
    ----------
    plate_angle_rad : ndarray (steps,)
    relative_residual, sd : ndarray (steps,)
        (model - measurement) / measurement, and its standard deviation.
    fitted : int
        Number of parameters that were fitted to this sweep alone.
    """

    plate_angle_rad: Array
    relative_residual: Array
    sd: Array
    fitted: int


@dataclass(frozen=True, slots=True)
class Misfit:
    """Result of the test.

    Attributes
    ----------
    disagrees : bool
        Whether the common pattern is significant.
    p_value : float
    plate_angle_rad : (float, float)
        First and last angle of the region with the largest error.
    mean_relative_error : float
        In that region.
    """

    disagrees: bool
    p_value: float
    plate_angle_rad: tuple[float, float]
    mean_relative_error: float


NO_MISFIT = Misfit(disagrees=False, p_value=1.0, plate_angle_rad=(np.nan, np.nan), mean_relative_error=np.nan)
"""Result if there are too few data, or no significant pattern."""


@dataclass(frozen=True, slots=True)
class ReducedSweep:
    """One sweep, with its forces converted to the same flow and speed.

    Attributes
    ----------
    plate_angle_rad : ndarray (angles,)
    log_force, sd : ndarray (angles,)
        ln(force, N) at each angle, and its standard deviation.
    mass_flow_kg_s : float
        Mean flow at home, measured with the parameters in use at that time.
    elevator_speed_rad_s : float
    moisture_pct : float
        nan if it is not known.
    home_log_force : float
        ln(force, N) of this flow at home; nan if it was not stored.
    """

    plate_angle_rad: Array
    log_force: Array
    sd: Array
    mass_flow_kg_s: float
    elevator_speed_rad_s: float
    moisture_pct: float = float("nan")
    home_log_force: float = float("nan")

    def measured_by(self, model: ForwardModel, parameters: ParameterSet) -> ReducedSweep:
        """The sweep with the flow that other parameters give for the force at home; unchanged if that force is not known."""
        if not np.isfinite(self.home_log_force):
            return self
        flow = OpenLoop(model, parameters).invert(
            np.exp(self.home_log_force), model.machine.home_plate_angle_rad, self.elevator_speed_rad_s, self.moisture_pct
        )
        known = np.isfinite(flow) and flow > 0.0
        return replace(self, mass_flow_kg_s=float(flow)) if known else self


def reduce_sweep(
    model: ForwardModel,
    parameters: ParameterSet,
    *,
    time_s: Array,
    plate_angle_rad: Array,
    elevator_speed_rad_s: Array,
    force_n: Array,
    force_std_dev_n: Array,
    moisture_pct: Array,
) -> ReducedSweep | None:
    """Average a sweep's windows at each plate angle.

    The flow of a window is interpolated between the visits home (`home_flow`). The model is only used to convert the force from
    the window's flow and speed to their means.

    Parameters
    ----------
    model : ForwardModel
    parameters : ParameterSet
        In use.
    time_s, plate_angle_rad, elevator_speed_rad_s, force_n, force_std_dev_n, moisture_pct : ndarray (windows,)

    Returns
    -------
    ReducedSweep or None
        None if no window has a usable force and flow, or the model needs a moisture that is not known.
    """
    known = np.isfinite(moisture_pct)
    moisture = float(np.median(moisture_pct[known])) if np.any(known) else float("nan")
    if model.needs_moisture and not np.isfinite(moisture):
        return None
    with np.errstate(invalid="ignore"):
        usable = np.isfinite(plate_angle_rad) & (elevator_speed_rad_s > 0.0) & (force_n > 0.0) & (force_std_dev_n > 0.0)
    windows = SweepWindows(
        time_s[usable], plate_angle_rad[usable], elevator_speed_rad_s[usable], force_n[usable],
        force_std_dev_n[usable] / force_n[usable], moisture,
    )  # fmt: skip
    if not np.any(windows.at_home(model.machine.home_plate_angle_rad)):
        return None
    (flows,) = window_flows(model, parameters, [windows])
    known_flow = np.isfinite(flows.log_flow)
    if not np.any(known_flow):
        return None
    angle, speed = windows.plate_angle_rad[known_flow], windows.elevator_speed_rad_s[known_flow]
    force, relative_sd = windows.force_n[known_flow], windows.relative_sd[known_flow]
    mean_flow, mean_speed = float(np.exp(np.mean(flows.visits.log_flow))), float(np.mean(speed))
    there = model_force_n(model, parameters.values, angle, speed, np.exp(flows.log_flow[known_flow]), moisture)
    here = model_force_n(model, parameters.values, angle, mean_speed, mean_flow, moisture)
    with np.errstate(invalid="ignore", divide="ignore"):
        log_force = np.log(force * here / there)
    good = np.isfinite(log_force)
    if not np.any(good):
        return None
    means = _by_angle(angle[good], log_force[good], relative_sd[good], flows.sd[known_flow][good])
    home_rad = np.array([model.machine.home_plate_angle_rad])
    (at_home,) = model_force_n(model, parameters.values, home_rad, mean_speed, mean_flow, moisture)
    return ReducedSweep(*means, mean_flow, mean_speed, moisture, float(np.log(at_home)))


def pooled_residuals(
    model: ForwardModel, parameters: ParameterSet, sweeps: Sequence[ReducedSweep]
) -> tuple[list[SweepResiduals], int]:
    """Residuals of sweeps after a joint fit of friction, density and impact gain.

    The prior is not used, since a pattern that a recalibration would remove is no error of the model. Friction and density are
    limited to their physical ranges.

    Returns
    -------
    list of SweepResiduals
    int
        Number of the three parameters that did not end at a limit.
    """
    sizes = [s.plate_angle_rad.size for s in sweeps]
    measured, sd = (np.concatenate([getattr(s, name) for s in sweeps]) for name in ("log_force", "sd"))
    flow, speed, moisture = (
        np.repeat([getattr(s, name) for s in sweeps], sizes)
        for name in ("mass_flow_kg_s", "elevator_speed_rad_s", "moisture_pct")
    )
    conditions = Conditions(
        np.concatenate([s.plate_angle_rad for s in sweeps]), speed, mass_flow_kg_s=flow, moisture_pct=moisture
    )
    start = np.array([*(parameters.values[name] for name in _FREE), 0.0])
    least, most = zip(*(search_bounds(name) for name in _FREE), strict=True)
    low, high = np.minimum([*least, -_MOST_LOG_GAIN], start), np.maximum([*most, _MOST_LOG_GAIN], start)

    def difference(theta: Array) -> tuple[Array, Array]:
        """ln(model) - ln(measurement), and its derivatives; nan above a full paddle."""
        values = dict(parameters.values) | dict(zip(_FREE, theta[:-1].tolist(), strict=True))
        force, slopes = model.derivatives(conditions, values, _FREE, of="force")
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(force) + theta[2] - measured, np.column_stack((slopes / force[:, None], np.ones(len(force))))

    def whitened(theta: Array, _: NDArray[np.intp]) -> tuple[Array, Array]:
        value, slopes = difference(theta[0])
        good = np.isfinite(value)
        return np.where(good, value / sd, 0.0)[None], np.where(good[:, None], slopes / sd[:, None], 0.0)[None]

    found = levenberg_marquardt(whitened, start[None], low, high, iterations=30, tolerance=1e-5).theta[0]
    parts = np.split(difference(found)[0], np.cumsum(sizes)[:-1])
    left = [SweepResiduals(s.plate_angle_rad, r, s.sd, 0) for s, r in zip(sweeps, parts, strict=True)]
    return left, int(np.count_nonzero((found > low) & (found < high)))


def _by_angle(angle: Array, values: Array, noise: Array, bracket: Array) -> tuple[Array, Array, Array]:
    """Mean angle, mean value and standard deviation at each angle. noise is independent; bracket, the error of the interpolated
    flow, is common to the windows at an angle."""
    numbers = cluster(angle, SAME_ANGLE_RAD)
    weight = 1.0 / (noise**2 + bracket**2)
    total = np.bincount(numbers, weight)

    def mean(column: Array) -> Array:
        return np.asarray(np.bincount(numbers, weight * column) / total)

    own = np.bincount(numbers, (weight * noise) ** 2) / total**2
    return mean(angle), mean(values), np.sqrt(own + mean(bracket) ** 2)


def common_misfit(
    sweeps: Sequence[SweepResiduals],
    *,
    least_sweeps: int = 4,
    level: float = 0.001,
    tolerance: float = 0.0,
    shared: int = 0,
) -> Misfit:
    """Test the residual pattern over plate angle that the sweeps have in common.

    If the sweeps scatter about the common pattern by more than their stated standard deviations, these are widened, so that a
    varying flow does not cause a false alarm.

    Parameters
    ----------
    sweeps : sequence of SweepResiduals
    least_sweeps : int
        With fewer sweeps the result is `NO_MISFIT`.
    level : float
        p value below which the pattern is significant.
    tolerance : float
        Standard deviation of a tolerated relative model error at each angle, which does not average out over sweeps.
    shared : int
        Number of parameters fitted to all sweeps together.
    """
    usable = [s for s in sweeps if len(s.relative_residual) > s.fitted + 1]
    if len(usable) < least_sweeps:
        return NO_MISFIT
    angle = np.concatenate([s.plate_angle_rad for s in usable])
    residual = np.concatenate([s.relative_residual for s in usable])
    sd = np.concatenate([s.sd for s in usable])
    good = np.isfinite(angle) & np.isfinite(residual) & np.isfinite(sd) & (sd > 0.0)
    angle, residual, sd = angle[good], residual[good], sd[good]
    if angle.size == 0:
        return NO_MISFIT
    numbers = cluster(angle, SAME_ANGLE_RAD)
    count = int(numbers.max()) + 1
    weight = np.bincount(numbers, 1.0 / sd**2, count)
    mean = np.bincount(numbers, residual / sd**2, count) / weight
    fitted = float(np.mean([s.fitted for s in usable]))
    within_dof = angle.size - count - (len(usable) - 1) * fitted
    free = count - fitted - shared
    if free < 1.0 or within_dof < 3.0:
        return NO_MISFIT
    scatter = max(float(np.sum(((residual - mean[numbers]) / sd) ** 2)) / within_dof, 1.0)
    weight = 1.0 / (scatter / weight + tolerance**2)
    between = float(np.sum(mean**2 * weight)) / free
    from scipy.special import fdtrc

    p_value = float(fdtrc(free, within_dof, between))
    if p_value >= level:
        return replace(NO_MISFIT, p_value=p_value)
    first, last = _strongest_run(mean * np.sqrt(weight))
    centre = np.bincount(numbers, angle, count) / np.bincount(numbers, minlength=count)
    inside = slice(first, last + 1)
    error = float(np.sum(mean[inside] * weight[inside]) / np.sum(weight[inside]))
    return Misfit(
        disagrees=True,
        p_value=p_value,
        plate_angle_rad=(float(centre[first]), float(centre[last])),
        mean_relative_error=error,
    )


def _strongest_run(whitened: Array) -> tuple[int, int]:
    """First and last index of the contiguous range with the largest |sum| / sqrt(length)."""
    total = np.concatenate(([0.0], np.cumsum(whitened)))
    best, place = -1.0, (0, 0)
    for first in range(len(whitened)):
        for last in range(first, len(whitened)):
            score = abs(float(total[last + 1] - total[first])) / np.sqrt(last - first + 1.0)
            if score > best:
                best, place = score, (first, last)
    return place
