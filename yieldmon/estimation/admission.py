"""Whether a sweep's update is admitted: not where the parameters are those of a model that does not describe the machine.

What a sweep says of friction and fill is as good as the model's profile over the plate angle. Where a calibration at known
loads has driven a parameter to an end of its physical range, or has missed held-out angles and loads, that profile is known to be
wrong, and what an update does to the flow at home is then the model's error projected on it, of either sign. Nor where other
machines' loads, weighed at home, are all that is known: these hold the error of the flow at home, and a plate a degree off its
reported angle is enough for sweeps to make it larger (studies/fleet_prior). Weighed masses are not concerned: they speak of the
flow itself.

Source: Brynjarsdottir and O'Hagan, Inverse Problems 30 (2014), on parameters estimated through a model whose error is not known.
"""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.grain import at_search_end

from .closed_loop_settings import ClosedLoopSettings
from .load_pattern import another_curve
from .parameters import METHOD, POOLED, ParameterSet

STOP_GAP = "stop_gap"
"""Effect that stands for what a calibration saw the model miss (`estimation.fitting.stop_gap`)."""

LARGEST_MODEL_ERROR = 0.02
"""On angles and loads that a calibration left out, relative; twice what a sweep is read with by default."""


def refusal(parameters: ParameterSet) -> str:
    """Why sweeps do not update these parameters: the model does not describe the machine.

    Parameters
    ----------
    parameters : ParameterSet
        Those in use, or those that an update would lead to. Parameters without a variance do not count.

    Returns
    -------
    str
        One sentence, "" where they may.
    """
    if parameters.model_error is not None and parameters.model_error > LARGEST_MODEL_ERROR:
        return (
            f"the calibration missed angles and loads that it left out by {100.0 * parameters.model_error:.0f} %: sweeps change "
            "nothing (see yieldmon diagnose)"
        )
    if STOP_GAP in parameters.effects:
        return "the calibration rests on a stop-gap for what the model misses: sweeps change nothing (see yieldmon diagnose)"
    if another_curve(parameters):
        return (
            "weighed loads show another curve of the force than the model's (load_pattern): sweeps, which rest on the model's, "
            "change nothing"
        )
    ends = at_search_end(parameters.values, parameters.covariance_names)
    if not ends:
        return ""
    return (
        f"{' and '.join(ends)} at an end of the physical range: the model does not describe this machine, and sweeps change "
        "nothing (see yieldmon diagnose)"
    )


def sweep_refusal(parameters: ParameterSet) -> str:
    """Why sweeps do not update these parameters: as `refusal`, or since nothing of this machine is known yet.

    Parameters
    ----------
    parameters : ParameterSet
        Those in use.

    Returns
    -------
    str
        One sentence, "" where they may.
    """
    if parameters.provenance.get(METHOD) == POOLED and not parameters.is_weighed:
        return (
            "the loads of other machines do not show how this machine's force follows the plate angle: sweeps change nothing "
            "until a load is weighed"
        )
    return refusal(parameters)


def allowing_for(settings: ClosedLoopSettings, parameters: ParameterSet) -> ClosedLoopSettings:
    """The settings with a model error of at least what the calibration found on angles and loads that it left out."""
    if parameters.model_error is None or parameters.model_error <= settings.model_error:
        return settings
    return replace(settings, model_error=parameters.model_error)
