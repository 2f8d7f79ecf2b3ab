"""Whether loads or readings that are too small for grain may be in another unit than the stated one.

If mass flow and density are multiplied by a, and the impact gain is divided by a, all forces stay the same. Loads in a wrong unit
therefore lead to an impossible density, and readings in a wrong unit to an impossible gain. If the rows determine density and
gain, a unit that puts them outside their physical ranges is refuted. A gain below 1 alone does not indicate a wrong unit, since
it also occurs when grain misses the plate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
import scipy

from yieldmon.estimation.fitting.calibration import default_start
from yieldmon.estimation.fitting.calibration_problem import CalibrationProblem
from yieldmon.estimation.fitting.least_squares import levenberg_marquardt
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.priors import Bounds
from yieldmon.physics.grain import GRAIN, RESTITUTION_FORM
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.units import KG_PER_LB, N_PER_KGF, S_PER_H

_N_PER_LBF = KG_PER_LB * N_PER_KGF


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit that a column may be in by mistake. load, reading: one of it in the stated unit, for loads and for readings."""

    name: str
    load: float = 1.0
    reading: float = 1.0


MISTAKEN: Mapping[str, tuple[Unit, ...]] = {
    "mass_flow_kg_s": (Unit("t/h", load=1000.0 / S_PER_H), Unit("lb/s", load=KG_PER_LB)),
    "paddle_mass_kg": (Unit("lb", load=KG_PER_LB),),
    "force_n": (Unit("lbf", reading=_N_PER_LBF), Unit("kgf", reading=N_PER_KGF)),
    "momentum_kg_m_s": (Unit("lbf s", reading=_N_PER_LBF), Unit("kgf s", reading=N_PER_KGF)),
}
"""By column. Only larger units of readings and smaller units of loads, since both make readings look too small."""

_REFUTED = 0.001
"""p value below which a unit is refuted. It is small, because an undetected wrong unit costs more than a needless question."""
_SURELY_REFUTED = 1e-6
"""The same for the stated units if the readings are in the range of grain, since most such tables are right."""
_LEAST_ERROR = 0.01
"""Relative error of model and rows that is always assumed."""
_OF_LARGEST = 0.15
"""Share of the largest reading below which the assumed error no longer decreases with the reading."""
_FREE: Bounds = {"density": GRAIN["density"].limits, "restitution": (-0.99, 99.0)}
_NAMES = ("friction", "density", *RESTITUTION_FORM)
_STARTS, _STEPS, _COARSE = 4, 60, 1e-4
"""Number of starts and steps of a fit, and its tolerance (of parameters relative to their scale, and of the misfit)."""


def possible(model: ForwardModel, data: Measurements, columns: tuple[str, str]) -> tuple[str, ...]:
    """Units with which the rows would be plausible for grain.

    Parameters
    ----------
    model : ForwardModel
    data : Measurements
        In the units stated.
    columns : (str, str)
        Names of the columns of load and reading.

    Returns
    -------
    tuple of str
        Names of the units in `MISTAKEN` that the rows do not refute.

    References
    ----------
    Seber and Wild, "Nonlinear Regression" (Wiley, 1989), section 5.3: the F test of constraints.

    Examples
    --------
    >>> angle, flow = (each.ravel() for each in np.meshgrid(np.radians([45.0, 60.0, 75.0]), [4.0, 9.0, 14.0]))
    >>> model, grain = ForwardModel(Machine()), {"friction": 0.3, "restitution": 0.5, "density": 1100.0, "shape_ratio": 2.0}
    >>> momentum = model.paddle_momentum(Conditions(angle, 42.0, mass_flow_kg_s=flow), grain)
    >>> in_pounds = Measurements(Conditions(angle, 42.0, mass_flow_kg_s=flow / 0.4536), momentum)
    >>> "lb/s" in possible(model, in_pounds, ("mass_flow_kg_s", "force_n"))
    True
    """
    means = _means(data)
    units = [unit for column in columns for unit in MISTAKEN.get(column, ())]
    if means.momentum.size <= len(_NAMES):
        return tuple(unit.name for unit in units)
    best: dict[float, float] = {}
    return tuple(unit.name for unit in units if _p_value(model, _in_si(means, unit), best, unit.load) >= _REFUTED)


def stated_is_refuted(model: ForwardModel, data: Measurements) -> bool:
    """Whether the rows are certainly impossible for grain in the stated units, although each reading by itself is plausible.

    Parameters
    ----------
    model : ForwardModel
    data : Measurements
        In the units stated.

    Returns
    -------
    bool
        False if there are too few rows to decide.
    """
    means = _means(data)
    return means.momentum.size > len(_NAMES) and _p_value(model, means, {}, 1.0) < _SURELY_REFUTED


def _p_value(model: ForwardModel, data: Measurements, best: dict[float, float], load: float) -> float:
    """p value of the F test that density and impact gain lie in the ranges of grain. data: one row for each condition.

    best: cache of chi-square without these ranges, by unit of the loads; new values are added. The readings' unit does not
    change it.
    """
    start = default_start(model, data, RESTITUTION_FORM)
    inside, at = _misfit(model, data, start, None, _STARTS)
    if not isfinite(inside):
        return 0.0
    if load not in best:
        best[load] = _misfit(model, data, start | at, _FREE, 1)[0]
    free = min(inside, best[load])
    more = data.momentum.size - len(_NAMES)
    scale = max(free / more, 1.0)
    bounded = len(_FREE)
    return float(scipy.special.fdtrc(bounded, more, (inside - free) / bounded / scale))


def _misfit(
    model: ForwardModel, data: Measurements, start: Mapping[str, float], bounds: Bounds | None, starts: int
) -> tuple[float, dict[str, float]]:
    """Chi-square of the best fit (inf if the loads exceed a full paddle at every start) and its parameters, as exact as a p value
    needs."""
    problem = CalibrationProblem(model, data, start, _NAMES, prior=None, bounds=bounds, robust=False)
    first = np.clip([problem.start[name] for name in _NAMES], problem.lower, problem.upper)
    low, high = (np.clip([problem.ranges[name][i] for name in _NAMES], problem.lower, problem.upper) for i in (0, 1))
    others = np.random.default_rng(0).uniform(low, high, (starts - 1, len(_NAMES)))
    found = levenberg_marquardt(
        lambda theta, _: problem.residuals(theta, problem.row_sd),
        np.vstack((first, others)),
        problem.lower,
        problem.upper,
        scale=problem.unit,
        iterations=_STEPS,
        tolerance=_COARSE,
        least_gain=_COARSE,
    )
    best = int(np.argmin(found.cost))
    return 2.0 * float(found.cost[best]), dict(zip(_NAMES, map(float, found.theta[best]), strict=True))


def _means(data: Measurements) -> Measurements:
    """One mean row for each condition, with an error proportional to the reading."""
    at, cell = data.cells()
    mean: Array = np.bincount(cell, data.momentum) / np.bincount(cell)
    level = np.hypot(mean, _OF_LARGEST * float(np.max(np.abs(mean))))
    return Measurements(at, mean, _LEAST_ERROR * level)


def _in_si(data: Measurements, unit: Unit) -> Measurements:
    """The rows converted to SI as if they had been written in the given unit."""
    at, sigma = data.conditions, data.sigma
    name = "mass_flow_kg_s" if at.paddle_mass_kg is None else "paddle_mass_kg"
    turned = replace(at, **{name: unit.load * np.asarray(getattr(at, name), dtype=float)})
    return Measurements(turned, unit.reading * data.momentum, None if sigma is None else unit.reading * sigma)
