"""Standard deviation of the force by drift of the parameters since their last update."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, sqrt

import numpy as np

from yieldmon.engine.records import WindowRecord
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration import drift_spread
from yieldmon.estimation.self_calibration.steady_drift import Advance, DriftingParameters
from yieldmon.estimation.waveform.common_bias import CommonBias
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array


@dataclass(frozen=True, slots=True)
class DriftDeviation:
    """relative: standard deviation of the force. parameters: in use. steps: number of grain steps since the update."""

    relative: float
    parameters: ParameterSet
    steps: int


@dataclass(frozen=True, slots=True)
class RateSpread:
    """Covariance that rates of unknown size may have added (`drift_spread`), (n + 1, n + 1), and its parameters."""

    covariance: Array
    parameters: ParameterSet

    @classmethod
    def at(cls, held: RateSpread | None, used: ParameterSet, step: Advance, later: DriftingParameters, forgotten: Array) -> Array:
        """The spread after the time from the parameters in use to `later`; held: the spread at its start, None: it begins."""
        size = len(step.transition)
        if held is not None and held.parameters is used and len(held.covariance) == size + 1:
            start = held.covariance
        else:
            start = drift_spread.begin(step.covariance_before, len(later.names))
        return drift_spread.advanced(start, step.transition, forgotten)


def after_update(
    spread: Array, prior: Array, now: DriftingParameters, biases: tuple[CommonBias | None, CommonBias | None]
) -> Array:
    """Spread (n + 1, n + 1) after an update that took the states' covariance from `prior` to that of `now`; biases: of kernel
    noise before and after it."""
    if spread.shape != (len(now.joint) + 1,) * 2 or prior.shape != now.joint.shape:
        return drift_spread.begin(now.joint, len(now.names))
    before, after = biases if all(bias is not None for bias in biases) else (None, None)
    errors = drift_spread.by_update(_joined(prior, before), _joined(now.joint, after))
    return drift_spread.updated(spread, errors)


def _joined(joint: Array, bias: CommonBias | None) -> Array:
    return drift_spread.with_bias(joint, None if bias is None else (bias.cross, bias.variance))


def as_stated(known: ParameterSet, spread: Array) -> ParameterSet:
    """The set with the covariance that the standard deviation of a flow is computed from."""
    return replace(known, covariance=known.covariance + drift_spread.beyond(spread, len(known.covariance_names)))


def force_deviation(model: ForwardModel, used: ParameterSet, later: ParameterSet, record: WindowRecord) -> float:
    """Relative standard deviation of a window's force by the growth of the parameters' covariance.

    Parameters
    ----------
    model : ForwardModel
    used, later : ParameterSet
        In use, and the same with the covariance that drift has led to.
    record : WindowRecord
        The window, with a flow.

    Returns
    -------
    float
        By first order; 0 where a paddle would be full, or the moisture that the model needs is not known.
    """
    names = used.covariance_names
    moisture = record.moisture_pct if isfinite(record.moisture_pct) else None
    if not names or (moisture is None and model.needs_moisture):
        return 0.0
    there = Conditions(
        np.array(record.plate_angle_rad), np.array(record.elevator_speed_rad_s),
        mass_flow_kg_s=np.array(record.mass_flow_kg_s), moisture_pct=moisture,
    )  # fmt: skip
    force, slopes = model.derivatives(there, used.values, names)
    if not float(force) > 0.0:
        return 0.0
    relative = slopes / force
    variance = float(relative @ (later.covariance_of(names) - used.covariance) @ relative)
    return sqrt(max(variance, 0.0))
