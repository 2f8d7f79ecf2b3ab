"""Test whether a drift over a run, or an error between runs of different speeds, explains rows as well as an effect does.

If speeds are run one after the other, they are confounded with time, and a change of gain or zero looks like an effect of speed.
The same holds for loads and plate angles, but tables are commonly sorted by these, so that their order is weaker evidence. (On
run orders that are robust against drift: Box, Hunter and Hunter, Statistics for Experimenters, chapter 4.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.clusters import SAME_LOAD, cluster
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.numerics import Array

from .fit import Fit
from .observations import SAME_SPEED, Cells, Rows

BETWEEN = "an error between the runs of different elevator speeds"
DRIFT = "a steady drift over the run"


@dataclass(frozen=True, slots=True)
class OfOrder:
    """Best explanation by the order of the rows: `what`, and its -2 log evidence `merit`."""

    what: str
    merit: float


def speeds_in_turn(rows: Rows) -> bool:
    """Whether an elevator speed was returned to, so that it is not confounded with time; True for one speed, or an unknown
    order."""
    if rows.order is None:
        return True
    return _in_turn(cluster(np.log(rows.elevator_speed_rad_s), SAME_SPEED), rows.order)


def blocked_in_each_trial(rows: Rows) -> bool:
    """Whether every trial ran its elevator speeds one after the other, in one sequence: a drift over the run then adds up to an
    effect of speed, though each speed was returned to. False for one speed, one trial, or an unknown order."""
    if rows.order is None or len(set(rows.trial)) < 2:
        return False
    number, trial = cluster(np.log(rows.elevator_speed_rad_s), SAME_SPEED), np.array(rows.trial)
    sequences = set()
    for name in set(rows.trial):
        inside = trial == name
        if _in_turn(number[inside], rows.order[inside]):
            return False
        ran = number[inside][np.argsort(rows.order[inside], kind="stable")]
        sequences.add(tuple(int(n) for n in ran[np.flatnonzero(np.diff(ran, prepend=-1))]))
    return len(sequences) == 1


def is_asked(rows: Rows) -> bool:
    """Whether the order of rows can be an objection: times are stated, or speeds were run one after the other, once or in each
    trial."""
    return rows.order is not None and (rows.timed or not speeds_in_turn(rows) or blocked_in_each_trial(rows))


def blocked_by(rows: Rows) -> str:
    """Which of load and plate angle the rows are sorted by, with three values or more and none returned to, in words for a note.

    "" if there is none, the order is not known, or `time_s` states it.
    """
    if rows.order is None or rows.timed:
        return ""
    loads = np.log(np.maximum(rows.load, 1e-9))
    for what, values, width in (("load", loads, SAME_LOAD), ("plate angle", rows.plate_angle_rad, SAME_ANGLE_RAD)):
        number = cluster(values, width)
        if number.max(initial=0) >= 2 and not _in_turn(number, rows.order):
            return f"{what} by {what}"
    return ""


def _in_turn(number: NDArray[np.int64], order: Array) -> bool:
    """Whether one of several values was returned to; True for a single one."""
    changes = int(np.count_nonzero(np.diff(number[np.argsort(order, kind="stable")])))
    return changes != len(np.unique(number)) - 1 or changes == 0


def drift(without: Fit, scale: float, per_parameter: float) -> OfOrder:
    """The best drift over the rows' order, linear or with one bend, in addition to a model; the order must be known."""
    shapes = [(DRIFT, _over_run(without.frame.cells, degree)) for degree in (1, 2)]
    return _best(without, shapes, scale, per_parameter)


def of_order(without: Fit, scale: float, per_parameter: float) -> OfOrder | None:
    """The best explanation by an error of gain, zero or both, in addition to a model.

    The error is a drift, linear or with a bend, over `time_s` or over rows whose speeds were run one after the other, once or in
    each trial; or one error for each speed that was never returned to. None if the rows can show neither.
    """
    cells = without.frame.cells
    if not is_asked(cells.rows):
        return None
    shapes = [(DRIFT, _over_run(cells, 1)), (DRIFT, _over_run(cells, 2))]
    if not speeds_in_turn(cells.rows):
        shapes.append((BETWEEN, _of_speeds(cells)))
    return _best(without, shapes, scale, per_parameter)


def _best(without: Fit, shapes: Sequence[tuple[str, Array]], scale: float, per_parameter: float) -> OfOrder:
    """The likeliest of gain, zero or both, each over every one of the shapes."""
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
