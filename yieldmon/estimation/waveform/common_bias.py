"""Updates of the parameters' scale from kernel noise, with its bias as an additional state.

Kernel noise measures flow times exp(bias). The bias (by kernel weight, crop, cell and background) is nearly constant, so it does
not average out over many measurements. It is therefore estimated as a state with a value, a variance and a covariance with the
parameters, and every update of the parameters also updates it. Once a weighed load has fixed the scale, the bias is known, and
kernel noise then measures drift.

If the masses of kernels scatter more than when the bias was calibrated (broken kernels, another crop among them), the noise
increases as with fewer, heavier kernels. If a measurement and the mean force differ by more than their standard deviations, the
remaining uncertainty is increased by that ratio.

Sources: Schmidt, "Application of state-space methods to navigation problems" (1966), on biases as further states; Birge, Phys.
Rev. 40 (1932) 207, on results that differ by more than their standard deviations.
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
"""Random walk of the bias, standard deviation per root kilotonne of grain, since it depends on load and restitution."""
_LOAD_SD = 0.01
"""Additional relative standard deviation of one measurement by its load."""
_STEP = 1e-3
_LARGEST_STEP = 0.3
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True)
class KernelMeasurement:
    """Seconds with grain and their flow from kernel noise.

    Attributes
    ----------
    kernels_kg_s : ndarray (n,)
        Flow from kernel noise.
    force_n, plate_angle_rad, elevator_speed_rad_s, moisture_pct : ndarray (n,)
    random_sd : float
        Relative standard deviation of the mean flow by chance.
    lasting_sd : float
        Relative standard deviation that all seconds have in common.
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
    """Estimate of the logarithm of the bias.

    Attributes
    ----------
    value, variance : float
    cross : ndarray (n + r,)
        Covariance with the n parameters and r rates of `DriftingParameters`.
    largest : float
        Variance at which the random walk stops.
    """

    value: float
    variance: float
    cross: Array
    largest: float


@dataclass(frozen=True)
class KernelUpdate:
    """Result of `update`.

    Attributes
    ----------
    drifting : DriftingParameters
    bias : CommonBias
        After the update.
    difference, sd : float
        ln(flow from kernels) - bias - ln(flow from the mean force), and its standard deviation.
    moved : float
        Change of ln(flow from the mean force).
    errors : ndarray (n + r + 1, n + r + 1)
        Matrix by which the update changed errors of states and bias (`drift_spread.updated`).
    """

    drifting: DriftingParameters
    bias: CommonBias
    difference: float
    sd: float
    moved: float
    errors: Array


def begin(lasting_sd: float, states: int) -> CommonBias:
    """The prior of the bias. lasting_sd: its standard deviation. states: number of parameters and rates."""
    return CommonBias(0.0, lasting_sd**2, np.zeros(states), lasting_sd**2)


def carried(bias: CommonBias, transition: Array, harvested_kg: float) -> CommonBias:
    """The bias after a time step of the states. transition: as in `steady_drift.Advance`."""
    wandered = WANDER**2 * max(harvested_kg, 0.0) / KG_PER_KT
    room = max(bias.largest - bias.variance, 0.0)
    return replace(bias, cross=transition @ bias.cross, variance=bias.variance + min(wandered, room))


def followed(bias: CommonBias, before: DriftingParameters, after: DriftingParameters, *, widening: float = 1.0) -> CommonBias:
    """The bias after an update of the states by other data, through its covariance with the states.

    widening: as in `steady_drift.updated`. Raises ValueError if the states are not the same.
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
    """Joint Kalman update of parameters, rates and bias by one measurement.

    If the difference exceeds its standard deviation, the remaining uncertainty of the flow, and that of the bias correlated with
    it, is increased by that ratio. It is limited to the flow's uncertainty before and its change by the update.

    Raises
    ------
    ValueError
        If the mean force gives no flow, nothing is uncertain, or the step is too large to be linear.
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
    """Increase the part of the uncertainty that is correlated with the error of the flow.

    Parameters
    ----------
    joint, cross, variance
        Covariance of the states, that of the bias with them, and variance of the bias.
    slope : ndarray
        Derivatives of ln flow with respect to the states.
    factor : float
        Factor on the variance of the flow; no effect up to 1.
    most : float
        Largest resulting variance of ln flow.

    Returns
    -------
    tuple
        joint, cross and variance.
    """
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
    """A measurement from rows (kernels_kg_s, force_n, plate_angle_rad, elevator_speed_rad_s, moisture_pct) with independent
    noise."""
    kernels, force, angle, speed, moisture = np.array(seconds).T
    return KernelMeasurement(kernels, force, angle, speed, moisture, hypot(*random_sds) / len(random_sds), lasting_sd)


__all__ = ["CommonBias", "KernelMeasurement", "KernelUpdate", "begin", "carried", "followed", "measurement_of", "update"]
