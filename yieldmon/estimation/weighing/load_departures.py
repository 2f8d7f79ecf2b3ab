"""Errors of weighed loads as measured with given parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

from .load_fit import LoadProblem
from .load_inputs import LoadSettings, WeighedLoad


def departure(
    model: ForwardModel, known: ParameterSet, load: WeighedLoad, settings: LoadSettings | None = None
) -> tuple[float, float]:
    """Relative error of a load's measured mass, and its standard deviation from the parameters' covariance and the scale.

    Both are nan if a force of the load exceeds that of a full paddle.
    """
    errors, std_devs = departures(model, known, [load], settings)
    return float(errors[0]), float(std_devs[0])


def spread(model: ForwardModel, known: ParameterSet, load: WeighedLoad, settings: LoadSettings | None = None) -> float:
    """Relative standard deviation of a load's measured mass from the parameters' covariance alone."""
    return float(_measured(model, known, [load], settings).spreads(known)[0])


def departures(
    model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad], settings: LoadSettings | None = None
) -> tuple[Array, Array]:
    """`departure` of several loads: errors (n,) and standard deviations (n,). Moisture must be known of all loads or of none."""
    problem = _measured(model, known, loads, settings)
    return np.expm1(_ln_errors(problem)), np.hypot(problem.spreads(known), problem.errors.sd)


def errors_of(
    model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad], settings: LoadSettings | None = None
) -> Array:
    """The errors of `departures`, without the standard deviations."""
    return np.expm1(_ln_errors(_measured(model, known, loads, settings)))


def _measured(
    model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad], settings: LoadSettings | None
) -> LoadProblem:
    settings = LoadSettings() if settings is None else settings
    return LoadProblem(model, known, known, [load.condensed for load in loads], settings)


def _ln_errors(problem: LoadProblem) -> Array:
    return np.asarray(np.log(problem.mass(problem.start) / problem.weighed))
