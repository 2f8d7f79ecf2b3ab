"""Whether a drift over a run, or an error between runs of different speeds, explains rows as well as an effect does.

Speeds that are run one after the other are confounded with time: a gain or zero that changes meanwhile is an effect of speed to
such rows. (On designs whose run order guards against a drift: Box, Hunter and Hunter, Statistics for Experimenters, chapter 4.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.clusters import cluster
from yieldmon.physics.numerics import Array

from .fit import Fit
from .observations import SAME_SPEED, Cells, Rows

BETWEEN = "an error between the runs of different elevator speeds"
DRIFT = "a steady drift over the run"


@dataclass(frozen=True, slots=True)
class OfOrder:
    """What the order of the rows explains best: `what`, and its -2 log evidence `merit`."""

    what: str
    merit: float


def speeds_in_turn(rows: Rows) -> bool:
    """Whether an elevator speed was returned to, so that it is not one with time; True for one speed, or an unknown order."""
    if rows.order is None:
        return True
    number = cluster(np.log(rows.elevator_speed_rad_s), SAME_SPEED)[np.argsort(rows.order, kind="stable")]
    return int(np.count_nonzero(np.diff(number))) != int(number.max()) or int(number.max()) == 0


def of_order(without: Fit, scale: float, per_parameter: float) -> OfOrder | None:
    """The best of these explanations beside a model, with gain, zero or both off.

    A steady drift, or one that bends, over `time_s` or over rows whose speeds were run one after the other; one error for each
    of such speeds. None where the rows can show neither.
    """
    cells = without.frame.cells
    blocks = not speeds_in_turn(cells.rows)
    if cells.rows.order is None or not (blocks or cells.rows.timed):
        return None
    shapes = [(DRIFT, _over_run(cells, 1)), (DRIFT, _over_run(cells, 2))]
    if blocks:
        shapes.append((BETWEEN, _of_speeds(cells)))
    zero, gain = 1.0 / without.frame.sd, without.level
    found = [
        OfOrder(what, without.beside(np.concatenate([unit[:, None] * shape for unit in units], axis=1), scale, per_parameter))
        for what, shape in shapes
        for units in ((gain,), (zero,), (gain, zero))
    ]
    return min(found, key=lambda one: one.merit)


def _over_run(cells: Cells, degree: int) -> Array:
    """Legendre polynomials from degree 1 on of a cell's mean place in the run, -1 to 1, shape (cells, degree)."""
    order = cells.rows.order
    assert order is not None
    span = float(np.ptp(order))
    at = 2.0 * (order - order.min()) / span - 1.0 if span > 0.0 else np.zeros(len(order))
    number: NDArray[np.int64] = cells.rows.cell
    columns = [np.polynomial.legendre.legval(at, np.eye(degree + 1)[k]) for k in range(1, degree + 1)]
    count = np.bincount(number)
    return np.stack([np.bincount(number, column) / count for column in columns], axis=-1)


def _of_speeds(cells: Cells) -> Array:
    """Indicators of every speed but the first, shape (cells, speeds - 1)."""
    number = cluster(np.log(cells.elevator_speed_rad_s), SAME_SPEED)
    return np.asarray(np.eye(int(number.max()) + 1)[number][:, 1:])
