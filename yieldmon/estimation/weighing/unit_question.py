"""Whether loads or readings that are too small for grain may be in another unit than the one stated.

Mass flow and density times a, and the impact gain over a, leave every force as it is. So loads in another unit show as a
density that is no grain's, and readings in another unit as a gain that is none: where the rows determine these, a unit that
would put them out of the physical ranges is refuted. A gain below 1 alone is no sign of a unit: grain that misses the plate
has one as well.
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
    """A unit that a column may be in by mistake: what one of it is in the unit stated, for loads and for readings."""

    name: str
    load: float = 1.0
    reading: float = 1.0


MISTAKEN: Mapping[str, tuple[Unit, ...]] = {
    "mass_flow_kg_s": (Unit("t/h", load=1000.0 / S_PER_H), Unit("lb/s", load=KG_PER_LB)),
    "paddle_mass_kg": (Unit("lb", load=KG_PER_LB),),
    "force_n": (Unit("lbf", reading=_N_PER_LBF), Unit("kgf", reading=N_PER_KGF)),
    "momentum_kg_m_s": (Unit("lbf s", reading=_N_PER_LBF), Unit("kgf s", reading=N_PER_KGF)),
}
"""By column. Larger units alone for readings and smaller ones for loads: both make readings look too small."""

_REFUTED = 0.001
"""p value below which rows refute a unit: a wrong unit that is not asked about costs more than a needless question."""
_SURELY_REFUTED = 1e-6
"""The same for the units stated, where the readings are as large as some grain's: most such tables are right."""
_LEAST_ERROR = 0.01
"""Error of model and rows, as a share of the reading, that is always allowed for."""
_OF_LARGEST = 0.15
"""Share of the largest reading that the error of small ones is taken from."""
_FREE: Bounds = {"density": GRAIN["density"].limits, "restitution": (-0.99, 99.0)}
_NAMES = ("friction", "density", *RESTITUTION_FORM)
_STARTS, _STEPS, _COARSE = 4, 60, 1e-4
"""Of a fit: starts, steps, and the share of a parameter's scale and of the misfit that does not matter."""


def possible(model: ForwardModel, data: Measurements, columns: tuple[str, str]) -> tuple[str, ...]:
    """Units that would make the rows those of grain.

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
        Units of `MISTAKEN` that the rows do not refute.

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
    """Whether rows are surely no grain's in the units stated, whose readings alone do not show it.

    Parameters
    ----------
    model : ForwardModel
    data : Measurements
        In the units stated.

    Returns
    -------
    bool
        False for rows that are too few to say it.
    """
    means = _means(data)
    return means.momentum.size > len(_NAMES) and _p_value(model, means, {}, 1.0) < _SURELY_REFUTED


def _p_value(model: ForwardModel, data: Measurements, best: dict[float, float], load: float) -> float:
    """Probability that grain's own ranges of density and impact gain cost these rows, one a condition, as much by chance.

    best: chi-square without these ranges by the unit of the loads, which grows here; a unit of the readings does not change it.
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
    """Chi-square of the best fit, inf where no start can carry the loads, and its parameters; to what a p value needs."""
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
    """One row for each condition, with an error in proportion to the reading."""
    at, cell = data.cells()
    mean: Array = np.bincount(cell, data.momentum) / np.bincount(cell)
    level = np.hypot(mean, _OF_LARGEST * float(np.max(np.abs(mean))))
    return Measurements(at, mean, _LEAST_ERROR * level)


def _in_si(data: Measurements, unit: Unit) -> Measurements:
    """The rows, had they been written in another unit."""
    at, sigma = data.conditions, data.sigma
    name = "mass_flow_kg_s" if at.paddle_mass_kg is None else "paddle_mass_kg"
    turned = replace(at, **{name: unit.load * np.asarray(getattr(at, name), dtype=float)})
    return Measurements(turned, unit.reading * data.momentum, None if sigma is None else unit.reading * sigma)
