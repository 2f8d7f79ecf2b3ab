"""Values that count as one: plate angles, loads, speeds that were meant to be the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

SAME_LOAD = 0.03
"""Two loads are one condition when their logarithms differ by less than this."""
_SPEED_STEP = np.log(1.02)
_FLOW_STEP = np.log(1.1)
_MOISTURE_STEP_PCT = 2.0


def meant_conditions(
    elevator_speed_rad_s: Array, nominal_speed_rad_s: float, mass_flow_kg_s: Array, moisture_pct: Array
) -> tuple[Array, Array, Array]:
    """Speed, flow and moisture of the nearest of the conditions that count as the same: steps of 2 %, of 10 % and of 2 points.

    Parameters
    ----------
    elevator_speed_rad_s, mass_flow_kg_s, moisture_pct : array, shape (n,)
        As measured.
    nominal_speed_rad_s : float
        From which the steps of the speed are counted.

    Returns
    -------
    tuple of three arrays, shape (n,)
        rad/s, kg/s, %; nan where the moisture is not known.
    """
    return (
        nominal_speed_rad_s * np.exp(np.round(np.log(elevator_speed_rad_s / nominal_speed_rad_s) / _SPEED_STEP) * _SPEED_STEP),
        np.exp(np.round(np.log(mass_flow_kg_s) / _FLOW_STEP) * _FLOW_STEP),
        np.round(moisture_pct / _MOISTURE_STEP_PCT) * _MOISTURE_STEP_PCT,
    )


def cluster(values: Array, width: float) -> NDArray[np.int64]:
    """Number of the cluster of each value, in ascending order.

    Parameters
    ----------
    values
        (n,), finite.
    width
        Largest distance between the first and last value of a cluster.
    """
    order = np.argsort(values, kind="stable")
    ascending = values[order]
    steps = np.zeros(len(values), dtype=np.int64)
    first = 0
    while first < len(values):
        last = int(np.searchsorted(ascending, ascending[first] + width, side="right"))
        steps[max(last, first + 1) :] += 1
        first = max(last, first + 1)
    out = np.empty(len(values), dtype=np.int64)
    out[order] = steps
    return out
