"""Whether the residuals of several sweeps show a pattern that the model cannot make, and where.

One sweep's residuals may be a bad sweep; the same pattern over several is the model's. Residuals are averaged over sweeps at each
plate angle; their mean square over what the sweeps' own scatter and a tolerated model error allow is an F ratio, and the region
is the contiguous run of angles whose normalised sum is largest.
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
    """Residuals of one sweep after its own best fit: model minus measurement over measurement, and their sd; shapes (steps,).

    fitted: number of quantities that the sweep's fit took from these steps.
    """

    plate_angle_rad: Array
    relative_residual: Array
    sd: Array
    fitted: int


@dataclass(frozen=True, slots=True)
class Misfit:
    """disagrees: the common pattern is significant. Region and mean relative error of its strongest run of angles."""

    disagrees: bool
    p_value: float
    plate_angle_rad: tuple[float, float]
    mean_relative_error: float


NO_MISFIT = Misfit(disagrees=False, p_value=1.0, plate_angle_rad=(np.nan, np.nan), mean_relative_error=np.nan)
"""Nothing to say."""


@dataclass(frozen=True, slots=True)
class ReducedSweep:
    """One sweep brought to one flow and speed: logarithm of the force (N) at each plate angle and its sd, shapes (angles,).

    mass_flow_kg_s: mean of the flow at home, with the parameters then in use. moisture_pct: nan where not known. home_log_force:
    logarithm of the force (N) that this flow had at home; nan where it was not kept.
    """

    plate_angle_rad: Array
    log_force: Array
    sd: Array
    mass_flow_kg_s: float
    elevator_speed_rad_s: float
    moisture_pct: float = float("nan")
    home_log_force: float = float("nan")

    def measured_by(self, model: ForwardModel, parameters: ParameterSet) -> ReducedSweep:
        """The same with the flow that other parameters give for the force at home; unchanged where that is not known."""
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
    """A sweep's windows, arrays (windows,), as one value for each plate angle; None where they do not say.

    The flow of a window is that of the visits home around it (`home_flow`); the model only carries the force from it to the mean.
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
    """Residuals of sweeps after the best fit that friction, density and impact gain can do, the same for all sweeps.

    They may be anything physical (the gain anything), whatever is thought of them: a pattern that a recalibration would absorb is
    no disagreement of the model. Returns the residuals and how many of the three the fit could move (those not at a bound).
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
        """ln(model) - ln(measurement), and its derivatives; nan beyond a full paddle."""
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
    """Angle, mean value and sd at each angle; the error of the bracketing flow is common to the windows there."""
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
    """Test the pattern over plate angle that the sweeps share.

    tolerance: standard deviation of a relative model error at each angle that is tolerated; averaging over sweeps does not take
    it away. shared: quantities fitted to all sweeps together. Never disagrees on fewer than least_sweeps sweeps. The scatter of
    the sweeps about their common pattern widens the stated sd where it is larger, so that flow that wanders raises no alarm.
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
    """First and last cell of the contiguous run with the largest |sum| / sqrt(length)."""
    total = np.concatenate(([0.0], np.cumsum(whitened)))
    best, place = -1.0, (0, 0)
    for first in range(len(whitened)):
        for last in range(first, len(whitened)):
            score = abs(float(total[last + 1] - total[first])) / np.sqrt(last - first + 1.0)
            if score > best:
                best, place = score, (first, last)
    return place
