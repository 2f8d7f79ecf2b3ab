"""Whether one constant in every weighed mass, such as a wrong tare, would explain what the loads say of the flow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .load_fit import LoadFit, LoadProblem

_LEAST_LOADS = 3
_SURE = 4.0
"""Standard deviations from nought beyond which a constant is no chance."""
_LIKELY = 5.99
"""Squared standard deviations, of two parameters, that chance leaves within in 95 of 100 cases."""


@dataclass(frozen=True, slots=True)
class Constant:
    """A mass in every weighed one that is no grain, kg, and its standard deviation."""

    kg: float
    sd_kg: float


def constant_in_weighed(problem: LoadProblem, active: NDArray[np.bool_], both: LoadFit) -> Constant | None:
    """The constant beside which one factor explains the loads as well as density and gain apart do; None where there is none.

    None as well where density and gain lie within what is expected of the crop, so that nothing speaks for another cause.

    Parameters
    ----------
    problem : LoadProblem
    active : ndarray (n,)
        Loads that count.
    both : LoadFit
        Along both directions.

    Returns
    -------
    Constant or None
    """
    sd = problem.sd[active]
    expected = problem.prior[-2:, -2:]
    away = float(both.step @ np.linalg.solve(expected, both.step))
    if active.sum() < _LEAST_LOADS or away < _LIKELY:
        return None
    weighed, measured = problem.weighed[active], problem.mass(problem.start)[active]
    columns = np.column_stack((measured, np.ones(weighed.size))) / (sd * weighed)[:, None]
    covariance = np.linalg.pinv(columns.T @ columns)
    found = covariance @ columns.T @ (1.0 / sd)
    left = 1.0 / sd - columns @ found
    sd_kg = float(np.sqrt(covariance[1, 1]))
    as_well = float(left @ left) <= float(np.sum((both.error[active] / sd) ** 2)) + away
    return Constant(float(found[1]), sd_kg) if as_well and abs(found[1]) > _SURE * sd_kg else None
