"""Scale from kernel noise for updates of the parameters; all such measurements share one bias, which is a state of its own.

Kernel noise gives flow times exp(bias). The bias (of the kernels' weight, of crop, cell and background) is the same today as
tomorrow: a hundred hours of noise know the scale no better than the bias is known. So the bias has a value, a variance and a
covariance with the parameters, which every update carries along, whatever it comes from. A weighed load that fixes the scale
fixes the bias with it, and from then on kernel noise follows what drifts.

Kernels whose masses scatter otherwise than when the bias was found (broken kernels, another crop among them) raise the noise
and look in it like fewer, heavier ones. Where a measurement and the mean force lie further apart than their deviations say,
what the update leaves unknown is wider by that factor.

Sources: Schmidt, "Application of state-space methods to navigation problems" (1966), on biases as further states; Birge, Phys.
Rev. 40 (1932) 207, on results that lie further apart than their deviations say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, hypot, sqrt

import numpy as np

from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.drift_rates import KG_PER_KT
from yieldmon.estimation.self_calibration.steady_drift import DriftingParameters, widened
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

WANDER = 0.03
"""Standard deviation that the bias gains per root kilotonne of grain: it goes with load and restitution."""
_LOAD_SD = 0.01
"""Relative standard deviation of one measurement beside its noise: of the load that it was made at."""
_STEP = 1e-3
_LARGEST_STEP = 0.3
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True)
class KernelMeasurement:
    """Seconds of grain, and the flow that kernel noise gave for each.

    kernels_kg_s, force_n, plate_angle_rad, elevator_speed_rad_s, moisture_pct: (n,) arrays. random_sd: relative standard
    deviation of the mean of all of them by chance. lasting_sd: the relative one that they have in common.
    """

    kernels_kg_s: Array
    force_n: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    moisture_pct: Array
    random_sd: float
    lasting_sd: float


@dataclass(frozen=True)
class CommonBias:
    """What is known of the logarithm of the bias.

    cross: (n + r,) covariance with the n parameters and r rates of `DriftingParameters`. largest: variance beyond which it does
    not wander.
    """

    value: float
    variance: float
    cross: Array
    largest: float


@dataclass(frozen=True)
class KernelUpdate:
    """drifting, bias: after the measurement. difference, sd: of ln flow by kernels less bias and by mean force, and its
    deviation. moved: change of ln flow of the mean force. errors: what the update made of errors of states and bias
    (`drift_spread`).
    """

    drifting: DriftingParameters
    bias: CommonBias
    difference: float
    sd: float
    moved: float
    errors: Array


def begin(lasting_sd: float, states: int) -> CommonBias:
    """Nothing of it is known but its prior."""
    return CommonBias(0.0, lasting_sd**2, np.zeros(states), lasting_sd**2)


def carried(bias: CommonBias, transition: Array, harvested_kg: float) -> CommonBias:
    """After a time over which the states went by `transition`, as of `steady_drift.Advance`."""
    wandered = WANDER**2 * max(harvested_kg, 0.0) / KG_PER_KT
    room = max(bias.largest - bias.variance, 0.0)
    return replace(bias, cross=transition @ bias.cross, variance=bias.variance + min(wandered, room))


def followed(bias: CommonBias, before: DriftingParameters, after: DriftingParameters, *, widening: float = 1.0) -> CommonBias:
    """The bias after an update by other data: it follows by its covariance with the states.

    widening: as of `steady_drift.updated`. Raises ValueError where the states are not the same.
    """
    if before.joint.shape != after.joint.shape or before.parameters.covariance_names != after.parameters.covariance_names:
        raise ValueError("the bias of kernel noise cannot follow an update with other states")
    prior = widened(before.joint, before.parameters.covariance_names, widening)
    size = np.sqrt(np.maximum(np.diag(prior), 1e-300))
    gain = np.linalg.lstsq(prior / np.outer(size, size), bias.cross / size, rcond=1e-12)[0] / size
    lost = float(gain @ (prior - after.joint) @ gain)
    variance = min(max(bias.variance - lost, _LEAST_VARIANCE), bias.largest)
    value = bias.value + float(gain @ (after.state - before.state))
    return replace(bias, value=value, variance=variance, cross=gain @ after.joint)


def update(model: ForwardModel, drifting: DriftingParameters, bias: CommonBias, measurement: KernelMeasurement) -> KernelUpdate:
    """A Kalman update of parameters, rates and bias together by one measurement.

    Where the difference is beyond one deviation, what the update leaves unknown of the flow, and of the bias with it, is wider by
    that factor, up to what was unknown of the flow before and what the update moved it by.

    Raises ValueError where the mean force gives no flow, nothing is uncertain, or the step would be too long to be linear.
    """
    known = drifting.parameters
    names = known.covariance_names
    slope = np.zeros(len(drifting.joint))
    for i, name in enumerate(names):
        sd = known.standard_deviation(name)
        moved = replace(known, values={**known.values, name: known.values[name] + _STEP * sd})
        slope[i] = (_log_flow(model, moved, measurement) - _log_flow(model, known, measurement)) / (_STEP * sd)
    difference = float(np.mean(np.log(measurement.kernels_kg_s))) - bias.value - _log_flow(model, known, measurement)
    of_states, of_bias = drifting.joint @ slope + bias.cross, float(slope @ bias.cross) + bias.variance
    variance = float(slope @ of_states) + of_bias + measurement.random_sd**2 + _LOAD_SD**2
    gain = of_states / variance
    step = gain * difference
    moved_by = float(slope @ step)
    if not abs(moved_by) < _LARGEST_STEP:
        raise ValueError(f"kernel noise would move the flow by {100.0 * (exp(moved_by) - 1.0):+.0f} % at once")
    share = of_bias / variance
    joint = drifting.joint - np.outer(gain, of_states)
    cross, own = bias.cross - gain * of_bias, max(bias.variance - share * of_bias, _LEAST_VARIANCE)
    most = float(slope @ drifting.joint @ slope) + moved_by**2
    joint, cross, own = _apart(joint, cross, own, slope, factor=difference**2 / variance, most=most)
    joint = 0.5 * (joint + joint.T)
    values = dict(known.values)
    for i, name in enumerate(names):
        values[name] += float(step[i])
    count = len(names)
    after = DriftingParameters(
        replace(known, values=values, covariance=joint[:count, :count], version=known.version + 1),
        drifting.names,
        drifting.rates + step[count:],
        joint,
    )
    narrowed = CommonBias(bias.value + share * difference, own, cross, max(bias.largest, own))
    errors = np.eye(slope.size + 1) - np.outer(np.append(gain, share), np.append(slope, 1.0))
    return KernelUpdate(after, narrowed, difference, sqrt(variance), moved_by, errors)


def _apart(
    joint: Array, cross: Array, variance: float, slope: Array, *, factor: float, most: float
) -> tuple[Array, Array, float]:
    """Covariance of the states, that of the bias with them and its variance, with the part that goes with the flow's error larger
    by a factor, if above 1, up to a variance of the flow of `most`. slope: of ln flow by the states."""
    with_flow = joint @ slope
    of_flow = float(slope @ with_flow)
    if not of_flow > 0.0:
        return joint, cross, variance
    more = min(factor, most / of_flow) - 1.0
    if not more > 0.0:
        return joint, cross, variance
    of_bias = float(slope @ cross)
    share = more / of_flow
    return (
        joint + share * np.outer(with_flow, with_flow),
        cross + share * of_bias * with_flow,
        variance + share * of_bias**2,
    )


def _log_flow(model: ForwardModel, parameters: ParameterSet, measurement: KernelMeasurement) -> float:
    found = OpenLoop(model, parameters).estimate(
        measurement.force_n, measurement.plate_angle_rad, measurement.elevator_speed_rad_s, moisture_pct=measurement.moisture_pct
    )
    flow = np.asarray(found.mass_flow_kg_s)
    if not np.all(flow > 0.0):
        raise ValueError("the mean force gives no flow where kernel noise does")
    return float(np.mean(np.log(flow)))


def measurement_of(
    seconds: Sequence[tuple[float, float, float, float, float]], random_sds: Sequence[float], lasting_sd: float
) -> KernelMeasurement:
    """From (kernels_kg_s, force_n, plate_angle_rad, elevator_speed_rad_s, moisture_pct) of seconds whose noise is independent."""
    kernels, force, angle, speed, moisture = np.array(seconds).T
    return KernelMeasurement(kernels, force, angle, speed, moisture, hypot(*random_sds) / len(random_sds), lasting_sd)


__all__ = ["CommonBias", "KernelMeasurement", "KernelUpdate", "begin", "carried", "followed", "measurement_of", "update"]
