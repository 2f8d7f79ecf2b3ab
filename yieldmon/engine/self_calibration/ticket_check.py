"""Comparison of a scale ticket with its load by the parameters in use, before it counts."""

from __future__ import annotations

from math import hypot, inf, isfinite, log1p

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.self_calibration.reference_mass_inputs import weighed, weighed_mass
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.self_calibration.angle_error import AngleError
from yieldmon.estimation.weighing.load_departures import departure


def departure_of(
    reference: ReferenceMass, estimator: FlowEstimator, drift_sd: float, model_error: AngleError
) -> tuple[float, float] | None:
    """Deviation of a weighed mass from the mass of its load.

    Parameters
    ----------
    reference : ReferenceMass
        The ticket's share of the load.
    estimator : FlowEstimator
        With the parameters in use.
    drift_sd : float
        Relative standard deviation of the load's mass by drift.
    model_error : AngleError
        By what sweeps show.

    Returns
    -------
    (float, float) or None
        ln of the weighed mass over the load's by these parameters, and its standard deviation; None where there is no number.
    """
    if not isinstance(estimator, OpenLoop) or reference.forces is None or not reference.complete:
        return None
    parameters, model = estimator.parameters, estimator.model
    try:
        load = weighed(reference, weighed_mass(reference, model, [(inf, parameters)], 0.0, model_error))
        error, std_dev = departure(model, parameters, load)
    except ValueError:
        return None
    if not (isfinite(error) and isfinite(std_dev) and error > -1.0):
        return None
    return -log1p(error), hypot(std_dev, drift_sd, model_error.home)
