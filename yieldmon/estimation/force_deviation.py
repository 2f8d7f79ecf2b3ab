"""Standard deviation of a predicted force, by parameters and model."""

from __future__ import annotations

import numpy as np

from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .beyond_range import error_beyond, moisture_error_beyond
from .parameters import ParameterSet

SD_STEP = 1e-3
"""Of a standard deviation, for the derivatives by the parameters."""


def force_std_dev(model: ForwardModel, known: ParameterSet, conditions: Conditions) -> Array:
    """Standard deviation of the mean force by the parameters' covariance and the model's own error.

    Parameters
    ----------
    model : ForwardModel
        With the parameters' effects.
    known : ParameterSet
    conditions : Conditions

    Returns
    -------
    ndarray
        N, or the response's unit, of the conditions' shape; nan above a full paddle.
    """

    def force(values: dict[str, float]) -> Array:
        return np.asarray(np.real(model.force(conditions, values, overfull="nan")))

    values = dict(known.values)
    here = force(values)
    slopes = np.zeros((*here.shape, len(known.covariance_names)))
    for k, name in enumerate(known.covariance_names):
        step = SD_STEP * known.standard_deviation(name)
        if step > 0.0:
            slopes[..., k] = (force({**values, name: values[name] + step}) - here) / step
    variance = np.einsum("...i,ij,...j->...", slopes, known.covariance, slopes)
    speed = np.broadcast_to(conditions.elevator_speed_rad_s, here.shape)
    angle = np.broadcast_to(conditions.plate_angle_rad, here.shape)
    own = np.hypot(known.own_error, error_beyond(known, _flow(model.machine, conditions, speed), angle, speed))
    own = np.hypot(own, known.scale_error)
    if conditions.moisture_pct is not None:
        # Of the flow, to which the force is proportional or less.
        own = np.hypot(own, moisture_error_beyond(known, np.broadcast_to(conditions.moisture_pct, here.shape)))
    return np.asarray(np.sqrt(np.maximum(variance, 0.0) + (own * here) ** 2))


def _flow(machine: Machine, conditions: Conditions, speed: Array) -> Array:
    if conditions.paddle_mass_kg is None:
        return np.broadcast_to(np.asarray(conditions.mass_flow_kg_s, dtype=float), speed.shape)
    return np.asarray(np.asarray(conditions.paddle_mass_kg, dtype=float) * machine.passes_per_s(speed))
