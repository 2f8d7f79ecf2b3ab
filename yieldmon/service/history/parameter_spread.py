"""By how much a load that is measured again may be off by the parameters that do it."""

from __future__ import annotations

from dataclasses import replace
from math import hypot, isfinite

import numpy as np

from yieldmon.estimation.beyond_range import error_beyond
from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.service.logs.force_seconds import known_seconds
from yieldmon.service.logs.measured_loads import MeasuredLoad
from yieldmon.service.storage.load_spread import ParameterSpread, divided

_SECONDS = 100
"""Seconds of a load that are looked at, evenly spaced: a parameter's change of the mass shows in few of them."""
_STEP = 1e-2
"""Share of a standard deviation, and of the force, for finite differences."""


def states_its_scale(parameters: ParameterSet) -> bool:
    """Whether a spread by these parameters says what a mass may be off by: what no load of this machine has set the scale of may
    be off otherwise than by the parameters' own covariance."""
    return parameters.is_weighed or parameters.scale_error > 0.0


def parameter_spread(
    load: MeasuredLoad, parameters: ParameterSet, machine: Machine, covariance: Array | None = None
) -> ParameterSpread | None:
    """Relative standard deviation of a load's mass by the parameters that measure it again.

    Parameters
    ----------
    load : MeasuredLoad
    parameters : ParameterSet
        By which it is measured again.
    machine : Machine
    covariance : ndarray (n, n), optional
        Of the parameters at the load's time; that of `parameters` where it is not given.

    Returns
    -------
    ParameterSpread or None
        None where no second of it has a known force, or the forces make no number.
    """
    some = load.seconds[:: max(1, len(load.seconds) // _SECONDS)]
    known = known_seconds(some, load.parameters, machine)
    if not len(known.duration_s):
        return None
    model = ForwardModel(machine, parameters.effects)
    if model.needs_moisture:
        known = known.take(np.isfinite(known.moisture_pct))
    duration, force, angle = known.duration_s, known.force_n, known.plate_angle_rad
    speed, moisture = known.elevator_speed_rad_s, known.moisture_pct
    estimator = estimator_of(machine, parameters, model)
    if not isinstance(estimator, OpenLoop):
        found = estimator.estimate(force, angle, speed, 0.0, moisture)
        of_curve = divided(float(duration @ found.std_dev_kg_s / (duration @ found.mass_flow_kg_s)))
        return ParameterSpread(of_curve[:1], of_curve[1]) if isfinite(of_curve[1]) else None

    def flow_of(known: ParameterSet, factor: float = 1.0) -> Array:
        return OpenLoop(model, known).invert(factor * force, angle, speed, moisture if model.needs_moisture else None)

    flow = flow_of(parameters)
    per_error = (flow_of(parameters, 1.0 + _STEP) - flow) / _STEP
    measured = np.isfinite(flow) & np.isfinite(per_error)
    if not np.any(measured):
        return None

    def share(of_flow: Array) -> float:
        return float(duration[measured] @ of_flow[measured] / (duration[measured] @ flow[measured]))

    model_error = np.hypot(parameters.own_error, error_beyond(parameters, flow, angle, speed))
    scale, own = divided(parameters.scale_error * share(per_error))
    own = hypot(own, share(model_error * per_error))
    shared = [
        share(flow_of(_moved(parameters, _STEP * direction)) - flow) / _STEP
        for direction in _directions(parameters.covariance if covariance is None else covariance)
    ]
    spread = ParameterSpread((*shared, scale), own)
    return spread if all(map(isfinite, (*spread.shared, own))) else None


def _directions(covariance: Array) -> Array:
    """(n, n): rows whose products with themselves add up to the covariance, the symmetric root: the same row of two covariances
    that are nearly alike is nearly the same."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    apart = np.where(scale > 0.0, scale, 1.0)
    sizes, axes = np.linalg.eigh(covariance / np.outer(apart, apart))
    return np.asarray((axes * np.sqrt(np.maximum(sizes, 0.0))) @ axes.T * scale)


def _moved(parameters: ParameterSet, by: Array) -> ParameterSet:
    moved = {name: parameters.values[name] + float(part) for name, part in zip(parameters.covariance_names, by, strict=True)}
    return replace(parameters, values={**parameters.values, **moved})
