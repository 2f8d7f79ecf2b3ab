"""How far the force of parameters may be off by drift since they were learnt."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np

from yieldmon.engine.records import WindowRecord
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.model import Conditions, ForwardModel


@dataclass(frozen=True, slots=True)
class DriftDeviation:
    """relative: standard deviation of the force. parameters: that it is of. steps: of grain since they were learnt."""

    relative: float
    parameters: ParameterSet
    steps: int


def force_deviation(model: ForwardModel, used: ParameterSet, later: ParameterSet, record: WindowRecord) -> float:
    """Relative standard deviation of a window's force by what the parameters in use have become unsure by.

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
