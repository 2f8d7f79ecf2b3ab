"""A load's mass by other parameters than those that measured it."""

from __future__ import annotations

import numpy as np

from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.service.logs.force_seconds import known_seconds
from yieldmon.service.logs.measured_loads import MeasuredLoad
from yieldmon.service.logs.weighed_loads import LEAST_KNOWN_SHARE


def load_factor(load: MeasuredLoad, parameters: ParameterSet, machine: Machine) -> float | None:
    """Mass of a load by other parameters over its mass as measured.

    Parameters
    ----------
    load : MeasuredLoad
        Its seconds with mass, and the parameters that measured them.
    parameters : ParameterSet
        By which it is measured again.
    machine : Machine

    Returns
    -------
    float or None
        None where less than 90 % of the mass rests on a known force (and a known moisture where the parameters depend on it), or
        parameters that measured it are not known.
    """
    versions = {row.parameter_version for row in load.seconds}
    if not versions or not versions <= set(load.parameters):
        return None
    known = known_seconds(load.seconds, load.parameters, machine)
    if not known.mass_kg.sum() > LEAST_KNOWN_SHARE * load.mass_kg:
        return None
    model = ForwardModel(machine, parameters.effects)
    if model.needs_moisture:
        known = known.take(np.isfinite(known.moisture_pct))
    if not len(known.mass_kg):
        return None
    inputs = known.force_n, known.plate_angle_rad, known.elevator_speed_rad_s, known.moisture_pct
    flow = estimator_of(machine, parameters, model).invert(*inputs)
    measured = np.isfinite(flow)
    measured_kg = np.sum(known.mass_kg[measured])
    if not measured_kg > LEAST_KNOWN_SHARE * load.mass_kg:
        return None
    return float(np.sum(known.duration_s[measured] * flow[measured]) / measured_kg)
