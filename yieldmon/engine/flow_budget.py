"""The error budget of a flow from the errors of its force, for a window as it is measured and for a second measured again."""

from __future__ import annotations

from math import hypot

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.mass.budget import FlowBudget
from yieldmon.engine.settings import SweepSettings
from yieldmon.estimation.self_calibration.angle_error import AngleError

_flow_budget = maker_of(FlowBudget)


def without_noise(std_dev_kg_s: float, noise_kg_s: float) -> float:
    """The part of a flow's standard deviation that is not noise, kg/s."""
    rest_kg_s: float = max(0.0, std_dev_kg_s**2 - noise_kg_s**2) ** 0.5
    return rest_kg_s


def flow_budget(
    settings: SweepSettings,
    model_error: AngleError,
    plate_angle_rad: float,
    *,
    at_home: bool,
    drift_sd: float,
    per_error_kg_s: float,
    noise_kg_s: float,
    common_kg_s: float,
    zero_kg_s: float,
    moisture_kg_s: float,
    motion_kg_s: float = 0.0,
) -> FlowBudget:
    """The standard deviation of a flow by cause.

    Parameters
    ----------
    settings : SweepSettings
        Away from home noise, motion and parameters are multiplied by its `max_std_dev_factor`.
    model_error : AngleError
        Of the force, from sweeps.
    plate_angle_rad : float
    at_home : bool
        Whether the plate is at the home angle.
    drift_sd : float
        Relative standard deviation of the force by drift since the last update.
    per_error_kg_s : float
        Change of the flow by a relative error of 1 of the force.
    noise_kg_s, common_kg_s : float
        Standard deviations by noise and by the parameters' covariance.
    zero_kg_s, moisture_kg_s : float
        Standard deviations by the zero and by moisture.
    motion_kg_s : float
        The part of `noise_kg_s` due to the motion of the plate, signed.

    Returns
    -------
    FlowBudget
    """
    error, parameters_kg_s = model_error.home, hypot(common_kg_s, drift_sd * per_error_kg_s)
    if not at_home:
        # Each part by itself, so that noise still averages out.
        error, factor = model_error.at(plate_angle_rad), settings.max_std_dev_factor
        noise_kg_s, motion_kg_s, parameters_kg_s = factor * noise_kg_s, factor * motion_kg_s, factor * parameters_kg_s
    shared_kg_s = hypot(parameters_kg_s, error * per_error_kg_s)
    return _flow_budget(noise_kg_s, shared_kg_s, zero_kg_s, moisture_kg_s, parameters_kg_s, per_error_kg_s, motion_kg_s, 0.0)
