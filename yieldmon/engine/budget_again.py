"""How sure the flow of a second is that was measured again, from what is kept of it."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import numpy as np

from yieldmon.engine.mass.budget import FlowBudget, zero_std_dev_mv
from yieldmon.engine.mass.moisture_reference import MoistureReference
from yieldmon.engine.parts import Parts
from yieldmon.engine.sampling.since_zero import KeptSecond
from yieldmon.estimation.open_loop import FlowEstimate
from yieldmon.physics.numerics import Array


def budgets(parts: Parts, seconds: Sequence[KeptSecond], force_n: Array, found: FlowEstimate) -> list[FlowBudget]:
    """The budget of each second's flow by the parameters in use, as `FlowMeter` makes it but for the plate's motion.

    Parameters
    ----------
    parts : Parts
    seconds : sequence of KeptSecond
        In order, since the zero that was undone.
    force_n : ndarray
        By the zero before it, N.
    found : FlowEstimate
        Of these forces.

    Returns
    -------
    list of FlowBudget
        nan where the estimator states no standard deviation.
    """
    settings, estimator, updater = parts.settings, parts.updater.estimator, parts.updater
    own, away_factor = found.noise_std_dev_kg_s, settings.sweep.max_std_dev_factor
    moisture = MoistureReference(settings.budget)
    if parts.flow_meter.moisture.state is not None:
        moisture.restore(parts.flow_meter.moisture.state)
    age_s = (parts.measurement.zero.before_age_s + np.cumsum([second.duration_s for second in seconds])).tolist()
    rows = []
    for k, second in enumerate(seconds):
        force, rate, spread = float(force_n[k]), float(found.mass_flow_kg_s[k]), float(found.std_dev_kg_s[k])
        share = second.force_std_dev_n / force if force > 0.0 else float("nan")
        noise = rate * share if own is None else float(own[k])
        per_error = noise / share if share > 0.0 else 0.0
        at_home = parts.measurement.at_home(second.plate_angle_rad)
        factor, error = (
            (1.0, updater.load_error.home) if at_home else (away_factor, updater.load_error.at(second.plate_angle_rad))
        )
        parameters = factor * hypot(max(0.0, spread**2 - noise**2) ** 0.5, updater.drift_sd * per_error)
        # Where a wrong zero left little of the force, what was stated of its noise holds little of the paddles' scatter.
        scatter_n = parts.measurement.scatter_n(force, second.elevator_speed_rad_s, second.duration_s * second.coverage)
        noise = hypot(noise, scatter_n * per_error / force) if force > 0.0 else noise
        zero_n = zero_std_dev_mv(settings.budget, age_s[k]) * parts.machine.sensor.gain_n_per_mv
        wet = moisture.std_dev_by(second.moisture_pct, estimator.parameters)
        zero = zero_n * per_error / force if force > 0.0 else 0.0
        rows.append(FlowBudget(factor * noise, hypot(parameters, error * per_error), zero, wet * rate))
    return rows
