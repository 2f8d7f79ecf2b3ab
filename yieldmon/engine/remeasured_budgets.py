"""Error budgets of seconds whose flow is measured again after an undo of the operator's zero calibration."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, nan
from typing import NamedTuple

import numpy as np

from yieldmon.engine.flow_budget import flow_budget, without_noise
from yieldmon.engine.mass.budget import FlowBudget, zero_std_dev_mv
from yieldmon.engine.mass.moisture_reference import MoistureReference
from yieldmon.engine.parts import Parts
from yieldmon.engine.sampling.since_zero import KeptSecond
from yieldmon.estimation.open_loop import FlowEstimate
from yieldmon.physics.numerics import Array


def remeasured_budgets(parts: Parts, seconds: Sequence[KeptSecond], force_n: Array, found: FlowEstimate) -> list[FlowBudget]:
    """The error budget of each second's flow by the parameters in use.

    It differs from that of `FlowMeter` in two points: the plate's motion is not known, and away from home the parameters'
    allowance for angles beyond the calibrated ones is not replaced by the model error that sweeps show.

    Parameters
    ----------
    parts : Parts
    seconds : sequence of KeptSecond
        In order, since the calibration that was undone, (n,).
    force_n : ndarray
        Mean forces by the zero before that calibration, N, (n,).
    found : FlowEstimate
        Flows by these forces, (n,).

    Returns
    -------
    list of FlowBudget
        (n,); nan where the estimator states no standard deviation.
    """
    moisture = MoistureReference(parts.settings.budget)
    if parts.flow_meter.moisture.state is not None:
        moisture.restore(parts.flow_meter.moisture.state)
    zero_age_s = parts.measurement.zero.before_age_s + np.cumsum([second.duration_s for second in seconds])
    noises = [None] * len(seconds) if found.noise_std_dev_kg_s is None else found.noise_std_dev_kg_s.tolist()
    rows = zip(force_n.tolist(), found.mass_flow_kg_s.tolist(), found.std_dev_kg_s.tolist(), noises, strict=True)
    measured = [_Remeasured(*row) for row in rows]
    return [
        _budget(parts, second, flow, moisture.std_dev_by(second.moisture_pct, parts.updater.estimator.parameters), age_s)
        for second, flow, age_s in zip(seconds, measured, zero_age_s.tolist(), strict=True)
    ]


class _Remeasured(NamedTuple):
    """Force and flow of a second by the other zero. noise_kg_s: None where the estimator does not state it."""

    force_n: float
    rate_kg_s: float
    std_dev_kg_s: float
    noise_kg_s: float | None


def _budget(parts: Parts, second: KeptSecond, flow: _Remeasured, moisture_sd: float, zero_age_s: float) -> FlowBudget:
    """moisture_sd: relative standard deviation of the flow by the grain's moisture."""
    settings, updater, measurement = parts.settings, parts.updater, parts.measurement
    force, rate, zero = flow.force_n, flow.rate_kg_s, 0.0
    share = second.force_std_dev_n / force if force > 0.0 else nan
    noise = rate * share if flow.noise_kg_s is None else flow.noise_kg_s
    per_error = noise / share if share > 0.0 else 0.0
    common = without_noise(flow.std_dev_kg_s, noise)
    if force > 0.0:
        # Where the wrong zero left little of the force, the noise stated with it contains little of the paddles' scatter.
        scatter_n = measurement.scatter_n(force, second.elevator_speed_rad_s, second.duration_s * second.coverage)
        noise = hypot(noise, scatter_n * per_error / force)
        zero = zero_std_dev_mv(settings.budget, zero_age_s) * parts.machine.sensor.gain_n_per_mv * per_error / force
    return flow_budget(
        settings.sweep,
        updater.load_error,
        second.plate_angle_rad,
        at_home=measurement.at_home(second.plate_angle_rad),
        drift_sd=updater.drift_sd,
        per_error_kg_s=per_error,
        noise_kg_s=noise,
        common_kg_s=common,
        zero_kg_s=zero,
        moisture_kg_s=moisture_sd * rate,
    )
