"""The model's error where it was not calibrated: relative, of the force, the more the further from the calibrated range.

Along each of plate angle, ln mass flow and ln elevator speed the error may have a slope. Before any table it is as large as laws
of other authors differ by; a range over which the fit left an error e bounds it, as far as a bend that leaves so much there could
go on with beyond, sqrt(180) e a range; where that error is not known the range bounds nothing. What is known within the range
stays as it is.
"""

from __future__ import annotations

import numpy as np

from yieldmon.physics.effects import effect_parameter
from yieldmon.physics.grain import FLOW_PER_MOISTURE_PCT
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.numerics import Array

from .model_error import FLOOR, LEAST_LEVEL
from .parameters import CalibratedRange, ParameterSet

PER_RAD = 0.4
"""Slope over the plate angle, standard deviation: both published tables, fitted at 70 deg alone, are missed by 20 % at 40 and by
11 to 15 % at 90 deg."""
PER_LN_FLOW, PER_LN_SPEED = (effect_parameter(f"load_pattern.{name}").prior_sd for name in ("exponent", "speed"))
"""Powers of flow and speed beside the model's, as weighed loads take them."""
_LEFT_BY_LOADS = 0.007
"""Relative error of the force over the flow that weighed loads, which the curve is fitted to, leave unseen between them: on
machines of other laws flows between the loads are off by as much beside what tickets are."""
_BEND = 180.0**0.5
"""Slope at the end of a parabola over a range of 1, of which a line is taken off, over its rms there."""


def error_beyond(parameters: ParameterSet, mass_flow_kg_s: Array, plate_angle_rad: Array, elevator_speed_rad_s: Array) -> Array:
    """Relative standard deviation of the force beside `model_error`.

    Parameters
    ----------
    parameters : ParameterSet
    mass_flow_kg_s, plate_angle_rad, elevator_speed_rad_s : ndarray
        Of one shape; speeds above 0.

    Returns
    -------
    ndarray
        0 within the calibrated range, along what it does not speak of, and where a value is nan.
    """
    by_speed = speed_error_beyond(parameters.calibrated, parameters.model_error, elevator_speed_rad_s)
    by_flow_and_speed = np.hypot(_by_flow(parameters, mass_flow_kg_s), by_speed)
    return np.asarray(np.hypot(angle_error_beyond(parameters, plate_angle_rad), by_flow_and_speed))


def angle_error_beyond(parameters: ParameterSet, plate_angle_rad: Array) -> Array:
    """The part of `error_beyond` by the plate's angle, rad."""
    limits = parameters.calibrated.plate_angle_rad
    if limits is None:
        return np.zeros(np.shape(plate_angle_rad))
    low, high = limits
    return _slope(PER_RAD, high - low, parameters.model_error) * _distance(
        plate_angle_rad, low - SAME_ANGLE_RAD, high + SAME_ANGLE_RAD
    )


def speed_error_beyond(calibrated: CalibratedRange, model_error: float | None, elevator_speed_rad_s: Array) -> Array:
    """The part of `error_beyond` by the elevator's speed, rad/s, above 0."""
    limits = calibrated.elevator_speed_rad_s
    if limits is None or not limits[0] > 0.0:
        return np.zeros(np.shape(elevator_speed_rad_s))
    low, high = np.log(limits)
    return _slope(PER_LN_SPEED, high - low, model_error) * _distance(np.log(elevator_speed_rad_s), low, high)


def moisture_error_beyond(parameters: ParameterSet, moisture_pct: Array) -> Array:
    """Relative standard deviation of the flow by grain wetter or drier (%) than was calibrated; 0 where the model follows that.

    Not part of `error_beyond`: the monitor keeps the moisture that its parameters hold for (`MoistureReference`)."""
    limits = parameters.calibrated.moisture_pct
    if limits is None or "moisture_dependence" in parameters.effects:
        return np.zeros(np.shape(moisture_pct))
    return FLOW_PER_MOISTURE_PCT * _distance(moisture_pct, *limits)


def _by_flow(parameters: ParameterSet, flow: Array) -> Array:
    limits = parameters.calibrated.mass_flow_kg_s
    if limits is None or not limits[1] > 0.0:
        return np.zeros(flow.shape)
    # Thin streams have the error of that share of the highest flow, as within the range.
    low, high, at = (0.5 * np.log(np.square(v / limits[1]) + LEAST_LEVEL**2) for v in (*np.array(limits), flow))
    span, left = float(high - low), parameters.model_error
    below = _slope(PER_LN_FLOW, span, left)
    # What a machine has beside the model grows with the load, so that less is known of more grain than was weighed.
    above = _slope(PER_LN_FLOW, span, max(left, _LEFT_BY_LOADS)) if left is not None and parameters.is_weighed else below
    return np.where(at > high, above, below) * _distance(at, low, high)


def _slope(before: float, span: float, model_error: float | None) -> float:
    """Standard deviation of the error's slope, by what is likely before any table, and by the error that the range has shown."""
    if model_error is None:
        return before
    return float(1.0 / np.hypot(1.0 / before, span / (_BEND * max(model_error, FLOOR))))


def _distance(value: Array, low: Array | float, high: Array | float) -> Array:
    """How far a value lies outside; 0 for nan."""
    return np.asarray(np.nan_to_num(np.maximum(np.maximum(low - value, value - high), 0.0)))
