"""Which estimator a parameter set asks for."""

from __future__ import annotations

from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel

from .flow_curve import CurveEstimator
from .open_loop import OpenLoop
from .parameters import ParameterSet


def estimator_of(machine: Machine, parameters: ParameterSet, model: ForwardModel | None = None) -> OpenLoop | CurveEstimator:
    """The set's curve where it has one, else the open loop with the effects that it names.

    Parameters
    ----------
    machine : Machine
    parameters : ParameterSet
    model : ForwardModel, optional
        Of machine and effects, where one exists already.

    Returns
    -------
    OpenLoop or CurveEstimator
    """
    if parameters.curve is not None:
        return CurveEstimator(parameters)
    return OpenLoop(ForwardModel(machine, parameters.effects) if model is None else model, parameters)
