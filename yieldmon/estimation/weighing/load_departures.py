"""How far weighed loads are from what given parameters measured."""

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
    """Relative error of a load as these parameters measure it, and its standard deviation by their covariance and the scale.

    Both are nan where the load holds more force than a full paddle gives.
    """
    errors, std_devs = departures(model, known, [load], settings)
    return float(errors[0]), float(std_devs[0])


def spread(model: ForwardModel, known: ParameterSet, load: WeighedLoad, settings: LoadSettings | None = None) -> float:
    """Relative standard deviation of a load by the covariance of these parameters alone."""
    return float(_measured(model, known, [load], settings).spreads(known)[0])


def departures(
    model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad], settings: LoadSettings | None = None
) -> tuple[Array, Array]:
    """`departure` of several loads, all with a known moisture or all without: errors (n,) and their standard deviations (n,)."""
    problem = _measured(model, known, loads, settings)
    return np.expm1(_ln_errors(problem)), np.hypot(problem.spreads(known), problem.sd)


def errors_of(
    model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad], settings: LoadSettings | None = None
) -> Array:
    """The errors of `departures` alone."""
    return np.expm1(_ln_errors(_measured(model, known, loads, settings)))


def _measured(
    model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad], settings: LoadSettings | None
) -> LoadProblem:
    settings = LoadSettings() if settings is None else settings
    return LoadProblem(model, known, known, [load.condensed for load in loads], settings)


def _ln_errors(problem: LoadProblem) -> Array:
    return np.asarray(np.log(problem.mass(problem.start) / problem.weighed))
