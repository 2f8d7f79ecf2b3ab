"""A load's mass by other parameters than those that measured it."""

from __future__ import annotations

import numpy as np

from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.service.logs.weighed_loads import LEAST_KNOWN_SHARE, MeasuredLoad, force_columns


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
    parts = [
        force_columns([row for row in load.seconds if row.parameter_version == v], load.parameters[v], machine)
        for v in sorted(versions)
    ]
    columns = np.concatenate(parts, axis=1)
    duration, force, angle, speed, moisture, mass = columns[:, np.isfinite(columns[0]) & (columns[0] > 0.0)]
    if not mass.sum() > LEAST_KNOWN_SHARE * load.mass_kg:
        return None
    model = ForwardModel(machine, parameters.effects)
    known = np.isfinite(moisture) if model.needs_moisture else np.full(mass.shape, fill_value=True)
    flow = np.full(mass.shape, np.nan)
    if np.any(known):
        inputs = (column[known] for column in (force, angle, speed, moisture))
        flow[known] = estimator_of(machine, parameters, model).invert(*inputs)
    measured = np.isfinite(flow)
    if not np.sum(mass[measured]) > LEAST_KNOWN_SHARE * load.mass_kg:
        return None
    return float(np.sum(duration[measured] * flow[measured]) / np.sum(mass[measured]))
