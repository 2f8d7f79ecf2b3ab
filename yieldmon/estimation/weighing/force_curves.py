"""What the curve of the force over the load may be, before any load is weighed.

The curve is the model's own (where the machine was weighed in another crop alone, the one that its loads have shown), one about
the force that goes with a power of the flow near 1, or one of two sizes about the model's; each is a normal prior of ln density,
ln gain and the weights of the effect `load_pattern`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from yieldmon.estimation.load_pattern import EFFECT, NAMES
from yieldmon.physics.effects import load_pattern
from yieldmon.physics.effects.load_pattern import reference_load_kg
from yieldmon.physics.model import Conditions
from yieldmon.physics.numerics import Array

from .load_fit import LoadProblem

_WEIGHT_SD = np.array([parameter.prior_sd for parameter in load_pattern.EFFECT.parameters])
_OWN, _POWER, _FREE = 0.6, 0.25, ((1.0, 0.1), (2.0, 0.05))
"""How likely are, before any load, the model's own curve, a power of the flow, and weights of a size over `_WEIGHT_SD`. These
and `_POWER_SD` were chosen on a linear model of loads that is not kept (studies/load_laws)."""
_POWER_SD = np.array([0.15, 0.1, _WEIGHT_SD[2]])
"""Of the weights about those with which the force is proportional to the flow."""
_LOADS = np.linspace(0.3, 2.0, 12)
"""Over the pattern's reference, on which those are found."""
_LEAST_POINTS = 6
"""Loads of a paddle at which the force is known, to find the weights of a curve."""


@dataclass(frozen=True)
class ForceCurve:
    """A prior of ln density, ln gain and weights relative to the start: mean (5,) and covariance (5, 5), whether the curve is
    another than the model's, and how likely it is."""

    mean: Array
    covariance: Array
    another: bool
    likely: float


def curves(problem: LoadProblem) -> tuple[ForceCurve, ...]:
    """What the curve of the force may be, before any load; the widest prior last.

    Parameters
    ----------
    problem : LoadProblem
        Of a model with `load_pattern`.
    """
    about = np.zeros(2 + len(NAMES))
    own = ForceCurve(about, _own_prior(problem), another=False, likely=_OWN)
    free = [ForceCurve(about, _prior(problem, size * _WEIGHT_SD), another=True, likely=likely) for size, likely in _FREE]
    proportional = _proportional(problem)
    if proportional is None:
        return own, *free
    return (
        own,
        ForceCurve(np.concatenate((about[:2], proportional)), _prior(problem, _POWER_SD), another=True, likely=_POWER),
        *free,
    )


def _own_prior(problem: LoadProblem) -> Array:
    """Covariance of the step on the start's own curve: none of the weights but where they are those of another crop."""
    prior = _prior(problem, np.zeros(len(NAMES)))
    if problem.start.carried_from:
        prior[2:, 2:] = problem.start.covariance_of(NAMES)
    return prior


def _prior(problem: LoadProblem, weight_sd: Array) -> Array:
    """Covariance of the step, with these standard deviations of the pattern's weights."""
    prior = np.diag(np.concatenate((np.zeros(2), weight_sd)) ** 2)
    prior[:2, :2] = problem.prior[-2:, -2:]
    return prior


def _proportional(problem: LoadProblem) -> Array | None:
    """The change of the pattern's weights (exponent, bend, speed) with which the force is proportional to the flow at the home
    angle and nominal speed, by least squares; None where a paddle cannot carry enough."""
    machine, start = problem.model.machine, problem.start
    loads_kg = _LOADS * reference_load_kg(machine)
    moisture = None if problem.moisture is None else np.full(loads_kg.shape, np.mean(problem.moisture))
    at = Conditions(
        np.full(loads_kg.shape, machine.home_plate_angle_rad),
        np.full(loads_kg.shape, machine.nominal_elevator_speed_rad_s),
        paddle_mass_kg=loads_kg,
        moisture_pct=moisture,
    )

    def ln_force(**weights: float) -> Array:
        values = dict(start.values) | {f"{EFFECT}.{name}": start.values[f"{EFFECT}.{name}"] + v for name, v in weights.items()}
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.log(np.real(problem.model.force(at, values, overfull="nan"))))

    here = ln_force()
    columns = np.column_stack((np.ones(loads_kg.size), ln_force(exponent=1.0) - here, ln_force(bend=1.0) - here))
    known = np.isfinite(columns).all(axis=1) & np.isfinite(here)
    if known.sum() < _LEAST_POINTS:
        return None
    found = np.linalg.lstsq(columns[known], (np.log(loads_kg) - here)[known], rcond=None)[0]
    return np.array([found[1], found[2], 0.0])
