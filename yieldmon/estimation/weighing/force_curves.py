"""Priors of the curve of force over load, before any load is weighed.

There are three kinds of curve: the model's own (or, if the machine has weighed loads in another crop only, the curve fitted to
those); curves near a force proportional to the flow; and curves that deviate from the model's by one of two sizes. Each is a
normal prior of ln density, ln gain and the weights of the effect `load_pattern`.
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
"""Prior probability of the model's own curve, of one near proportionality, and (size in `_WEIGHT_SD`, probability) of deviating
ones. These and `_POWER_SD` were chosen on a linear model of loads that is not kept (studies/load_laws)."""
_POWER_SD = np.array([0.15, 0.1, _WEIGHT_SD[2]])
"""Standard deviations of the weights about those that make the force proportional to the flow."""
_LOADS = np.linspace(0.3, 2.0, 12)
"""Loads of a paddle, relative to the pattern's reference, at which those weights are fitted."""
_LEAST_POINTS = 6
"""Least number of loads of a paddle with a known force for that fit."""


@dataclass(frozen=True)
class ForceCurve:
    """A normal prior of (ln density, ln gain, weights of `load_pattern`) relative to the start.

    Attributes
    ----------
    mean : ndarray (5,)
    covariance : ndarray (5, 5)
    another : bool
        Whether the curve differs from the model's.
    likely : float
        Prior probability of this curve.
    """

    mean: Array
    covariance: Array
    another: bool
    likely: float


def curves(problem: LoadProblem) -> tuple[ForceCurve, ...]:
    """The possible curves, the one with the widest prior last.

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
    """Covariance of the step on the start's own curve; the weights have a variance only where they come from another crop."""
    prior = _prior(problem, np.zeros(len(NAMES)))
    if problem.start.carried_from:
        prior[2:, 2:] = problem.start.covariance_of(NAMES)
    return prior


def _prior(problem: LoadProblem, weight_sd: Array) -> Array:
    """Covariance of the step with the given standard deviations of the pattern's weights."""
    prior = np.diag(np.concatenate((np.zeros(2), weight_sd)) ** 2)
    prior[:2, :2] = problem.prior[-2:, -2:]
    return prior


def _proportional(problem: LoadProblem) -> Array | None:
    """Change of the pattern's weights (exponent, bend, speed) that makes the force proportional to the flow at the home angle and
    nominal speed, by least squares; None if too few of the loads fit on a paddle."""
    machine, start = problem.model.machine, problem.start
    loads_kg = _LOADS * reference_load_kg(machine)
    measured_pct = problem.windows.moisture_pct
    moisture = None if measured_pct is None else np.full(loads_kg.shape, np.mean(measured_pct))
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
