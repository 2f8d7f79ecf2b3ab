"""Combination of two estimates of the flow, from the mean force and from the pulses' shape, and their agreement.

Both depend on the bulk density: with a higher density the flow from the mean force becomes smaller and that from the shape
larger. This is the scale direction (flow, density, 1 + e) -> (a, a, 1/a), which mean forces do not determine.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, hypot, isfinite, log, sqrt

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.model import Conditions, ForwardModel

_LEAST_VARIANCE = 1e-6
_STEP = 0.01


@dataclass(frozen=True, slots=True)
class Combined:
    """Combined flow.

    Attributes
    ----------
    mass_flow_kg_s : float
        Weighted mean with the least variance.
    relative_sd : float
        Standard deviation of its logarithm.
    z : float
        Difference between the two flows in standard deviations.
    weight : float
        Weight of the flow from the shape, 0 to 1.
    mean_volume_sd : float
        Standard deviation of ln(flow from the mean force / density).
    """

    mass_flow_kg_s: float
    relative_sd: float
    z: float
    weight: float
    mean_volume_sd: float = float("nan")


def relative_covariance(parameters: ParameterSet) -> tuple[float, float]:
    """Variance of ln(density) and its covariance with ln(1 + restitution); the latter 0 for parameters without restitution."""
    values, known = parameters.values, parameters.covariance_names
    if "density" not in known:
        return 0.0, 0.0
    row, density = parameters.covariance[known.index("density")], values["density"]
    variance = float(row[known.index("density")]) / density**2
    if "restitution" not in values or "restitution" not in known:
        return variance, 0.0
    return variance, float(row[known.index("restitution")]) / (density * (1.0 + values["restitution"]))


def combine(
    mean_flow_kg_s: float,
    mean_sd: float,
    shape_flow_kg_s: float,
    shape_sd: float,
    *,
    exponent: float,
    parameters: ParameterSet,
    heap: tuple[float, float] = (0.0, 0.0),
) -> Combined:
    """Combine two flows by their covariance.

    Parameters
    ----------
    mean_flow_kg_s, shape_flow_kg_s : float
        Flow from the mean force; flow from the shape, which is volume flow times density.
    mean_sd, shape_sd : float
        Relative standard deviations; shape_sd without the uncertainty of density.
    exponent : float
        d ln(force) / d ln(flow) at this flow; it determines how the flow from the mean force depends on density.
    parameters : ParameterSet
        The covariance of density and restitution is used.
    heap : tuple of 2 float
        Change of ln flow from the mean force (not contained in mean_sd) and from the shape (contained in shape_sd) by one
        standard deviation of the heap's shape.

    Returns
    -------
    Combined
        The flow from the mean force alone if the shape gives none.
    """
    if not (isfinite(shape_flow_kg_s) and isfinite(shape_sd) and shape_flow_kg_s > 0.0 and mean_flow_kg_s > 0.0):
        return Combined(mean_flow_kg_s, mean_sd, float("nan"), 0.0)
    of_density, with_gain = relative_covariance(parameters)
    first = mean_sd**2 + heap[0] ** 2
    second = shape_sd**2 + of_density
    # Derivatives of ln flow from the mean force: -(1 - n) / n by ln density, -1 / n by ln(1 + e).
    both = -((1.0 - exponent) * of_density + with_gain) / exponent + heap[0] * heap[1]
    limit = 0.95 * sqrt(first * second)
    both = min(max(both, -limit), limit)
    spread = first + second - 2.0 * both
    weight = min(max((first - both) / spread, 0.0), 1.0)
    difference = log(shape_flow_kg_s / mean_flow_kg_s)
    variance = (1.0 - weight) ** 2 * first + weight**2 * second + 2.0 * weight * (1.0 - weight) * both
    volume_sd = sqrt(max(first + second - shape_sd**2 - 2.0 * (both - heap[0] * heap[1]), _LEAST_VARIANCE))
    return Combined(mean_flow_kg_s * exp(weight * difference), sqrt(variance), difference / sqrt(spread), weight, volume_sd)


def heap_slope(
    model: ForwardModel,
    parameters: ParameterSet,
    *,
    mass_flow_kg_s: float,
    plate_angle_rad: float,
    elevator_speed_rad_s: float,
    moisture_pct: float,
) -> float:
    """d ln(flow from the mean force) / d ln(shape ratio) at constant force.

    Parameters
    ----------
    model : ForwardModel
    parameters : ParameterSet
    mass_flow_kg_s, plate_angle_rad, elevator_speed_rad_s, moisture_pct : float

    Returns
    -------
    float
        0 if the parameters' covariance contains the shape ratio, or the force does not depend on the load.
    """
    values, ratio = parameters.values, parameters.values["shape_ratio"]
    if "shape_ratio" in parameters.covariance_names and parameters.standard_deviation("shape_ratio") > 0.0:
        return 0.0
    load_kg = model.machine.per_paddle(mass_flow_kg_s, elevator_speed_rad_s)
    at = Conditions(
        plate_angle_rad,
        elevator_speed_rad_s,
        paddle_mass_kg=load_kg * np.exp([_STEP, -_STEP, 0.0, 0.0]),
        moisture_pct=moisture_pct,
    )
    ratios = ratio * np.exp([0.0, 0.0, _STEP, -_STEP])
    momentum = np.asarray(model.paddle_momentum(at, {**values, "shape_ratio": ratios}, overfull="nan"))
    if not np.all(momentum > 0.0):
        return 0.0
    by_load, by_ratio = np.log(momentum[0] / momentum[1]), np.log(momentum[2] / momentum[3])
    return float(-by_ratio / by_load) if by_load > 0.0 else 0.0


def together_sd(relative_sd: float, *, z: float, hit: float, hit_sd: float) -> float:
    """Standard deviation of a mean of channels whose own deviations may be too small, or that lose alike.

    Parameters
    ----------
    relative_sd : float
        Of the mean, by the channels' own deviations as if all were independent.
    z : float
        Largest difference of two channels over its standard deviation; beyond one it counts as a factor.
    hit : float
        Share of the mean that comes from channels that feel only the grain that hits the plate (mean force, kernel noise).
    hit_sd : float
        Relative standard deviation of what those lose or gain alike, of grain that misses the plate or strikes it again.

    Returns
    -------
    float
        Relative.

    Source: Birge, Phys. Rev. 40 (1932) 207, for results that lie further apart than their deviations say.
    """
    return hypot(relative_sd * max(1.0, abs(z)), hit * hit_sd)
