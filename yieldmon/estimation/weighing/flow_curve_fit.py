"""Calibration of a flow curve: from rows of known load, or from weighed loads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.beyond_range import PER_LN_FLOW
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.flow_curve import LEAST_RELATIVE_STD_DEV, OFFSET_SHARE, AlphaBeta, FlowCurve, LookUpTable, TableColumn
from yieldmon.estimation.parameters import CalibratedRange
from yieldmon.physics.machine import SAME_ANGLE_RAD, Machine
from yieldmon.physics.numerics import Array, span
from yieldmon.units import counted

from .load_inputs import WeighedLoad

LEAST_LOADS = 3
_MOST_KNOTS = 12
_LEAST_INNER = 3
"""Number of loads between the lightest and the heaviest from which on these two do not count in the standard deviation."""


@dataclass(frozen=True)
class CurveFit:
    """A calibrated curve and its errors.

    Attributes
    ----------
    curve : FlowCurve
    rows : int
        Number of rows or loads used.
    loads : tuple of float
        Flow of each row's condition, kg/s, or weighed mass of each load, kg.
    left_out_error : tuple of float
        Relative error of each of them when it is left out of the fit.
    fitted_error : tuple of float
        Relative error of each of them when all are fitted.
    """

    curve: FlowCurve
    rows: int
    loads: tuple[float, ...]
    left_out_error: tuple[float, ...]
    fitted_error: tuple[float, ...]


def fit_table(machine: Machine, rows: Measurements, kind: str) -> CurveFit:
    """A curve from rows of known load.

    Parameters
    ----------
    machine : Machine
    rows : Measurements
        In N and kg m/s, not in a response's own unit. Rows without a load are left out.
    kind : str
        "alpha_beta": rows at one plate angle; "table": at one or more.

    Returns
    -------
    CurveFit

    Raises
    ------
    ValueError
        Several angles for alpha-beta, or fewer than three loads at an angle.
    """
    columns = rows.columns()
    passes = machine.passes_per_s(columns[1])
    flow = columns[2] if rows.conditions.paddle_mass_kg is None else columns[2] * passes
    force = rows.momentum * passes
    used = (flow > 0.0) & (force > 0.0)
    angle, speed, load, force, flow = (v[used] for v in (columns[0], columns[1], columns[2], force, flow))
    angle = _one_each(angle)
    _refuse_few(kind, angle, load)

    def fitted(part: NDArray[np.bool_]) -> AlphaBeta | LookUpTable:
        if kind == AlphaBeta.kind:
            return AlphaBeta.fit(force[part], flow[part], speed[part], float(angle[0]))
        return _table(machine, force[part], flow[part], speed[part], angle[part])

    cells, cell = np.unique(np.stack((angle, speed, load)), axis=1, return_inverse=True)
    cell = cell.ravel()
    weight = np.bincount(cell)
    mean_force, mean_flow = np.bincount(cell, force) / weight, np.bincount(cell, flow) / weight
    errors = np.full(weight.size, np.nan)
    for value in np.unique(load):
        out = cells[2] == value
        law = fitted(load != value)
        errors[out] = law.flow(mean_force[out], cells[0][out], cells[1][out]) / mean_flow[out] - 1.0
    law = fitted(np.ones(flow.size, dtype=bool))
    own = law.flow(mean_force, cells[0], cells[1]) / mean_flow - 1.0
    share = mean_flow / (mean_flow + OFFSET_SHARE * mean_flow.max())
    moisture = columns[3][used]
    calibrated = CalibratedRange(span(flow), span(angle), span(speed), span(moisture) if np.all(np.isfinite(moisture)) else None)
    curve = FlowCurve(law, _relative(share * errors, share * own, _inner(cells[2])), calibrated)
    return CurveFit(curve, int(flow.size), tuple(mean_flow.tolist()), tuple(errors.tolist()), tuple(own.tolist()))


def _refuse_few(kind: str, angle: Array, load: Array) -> None:
    """Raises ValueError where the rows do not determine a curve of this kind."""
    if not angle.size:
        raise ValueError("no row has a load and a force above 0")
    for value in np.unique(angle):
        here = np.unique(load[angle == value]).size
        if here < LEAST_LOADS:
            raise ValueError(
                f"{counted(here, 'load')} at {np.degrees(value):g} deg; expected {LEAST_LOADS} or more that give a force above 0"
            )
    if kind == AlphaBeta.kind and np.ptp(angle) > 0.0:
        angles = ", ".join(f"{a:g}" for a in np.degrees(np.unique(angle)))
        raise ValueError(f"rows at {angles} deg; alpha_beta holds at one plate angle: choose it with --plate-angle")


def fit_loads(loads: Sequence[WeighedLoad], plate_angle_rad: float) -> CurveFit:
    """Alpha and beta from weighed loads.

    Seconds in which the plate is not at home are assumed to have the same mean flow as the load's seconds at home.

    Parameters
    ----------
    loads : sequence of WeighedLoad
        Three or more.
    plate_angle_rad : float
        The home angle, rad.

    Returns
    -------
    CurveFit
        beta is 0 if the fit with alpha alone has the smaller leave-one-out error.

    Raises
    ------
    ValueError
        Fewer than three loads, or one with no second at the home angle.
    """
    if len(loads) < LEAST_LOADS:
        raise ValueError(f"{len(loads)} weighed loads; expected {LEAST_LOADS} or more")
    design, seconds = [], []
    for load in loads:
        here = (np.abs(load.plate_angle_rad - plate_angle_rad) <= SAME_ANGLE_RAD) & (load.force_n > 0.0)
        if not np.any(here):
            raise ValueError(f"load {load.name} has no second with the plate at {np.degrees(plate_angle_rad):g} deg")
        x, time = load.force_n[here] / load.elevator_speed_rad_s[here], load.duration_s[here]
        whole = load.duration_s.sum() / time.sum()
        design.append((whole * float(time @ x), whole * float(time @ (x * x))))
        seconds.append((x, load.elevator_speed_rad_s[here]))
    matrix, weighed = np.array(design), np.array([load.weighed_kg for load in loads])

    def without(keep: NDArray[np.bool_], terms: int) -> Array:
        out = np.zeros(2)
        out[:terms] = np.linalg.lstsq(matrix[keep, :terms] / weighed[keep, None], np.ones(int(keep.sum())), rcond=None)[0]
        return out

    every = np.arange(weighed.size)
    tried = []
    for terms in (1, 2):
        errors = np.array([matrix[i] @ without(every != i, terms) / weighed[i] - 1.0 for i in every])
        tried.append((float(np.mean(errors**2)), terms, errors))
    _, terms, errors = min(tried, key=lambda entry: entry[:2])
    alpha, beta = without(every >= 0, terms).tolist()
    x = np.concatenate([part[0] for part in seconds])
    law = AlphaBeta(alpha, beta, plate_angle_rad)
    flow = (alpha + beta * x) * x
    moist = [load.moisture_pct for load in loads]
    moisture = None if any(m is None for m in moist) else span(np.concatenate([m for m in moist if m is not None]))
    speeds = span(np.concatenate([part[1] for part in seconds]))
    own = matrix @ np.array([alpha, beta]) / weighed - 1.0
    common = np.mean([load.common_kg / load.weighed_kg for load in loads])
    apart = _relative(errors, own, np.ones(weighed.size, dtype=bool))
    relative = float(np.hypot(apart, common))
    calibrated = CalibratedRange(span(flow), (plate_angle_rad, plate_angle_rad), speeds, moisture)
    level = np.log(weighed / [load.duration_s.sum() for load in loads])
    # Few loads may agree by chance better than their tickets' standard deviations allow.
    tickets = np.mean([load.relative_sd**2 - (load.common_kg / load.weighed_kg) ** 2 for load in loads])
    own_sd = max(apart, float(np.sqrt(tickets)))
    exponent = 1.0 / float(np.hypot(1.0 / PER_LN_FLOW, np.std(level) * np.sqrt(level.size) / own_sd))
    curve = FlowCurve(law, relative, calibrated, {}, exponent, float(np.exp(level.mean())))
    return CurveFit(curve, len(loads), tuple(weighed.tolist()), tuple(errors.tolist()), tuple(own.tolist()))


def _table(machine: Machine, force_n: Array, flow: Array, speed: Array, angle: Array) -> LookUpTable:
    """Mean force and flow at nominal speed, at most twelve points at each angle; points put out of order by noise are pooled."""
    slower = machine.nominal_elevator_speed_rad_s / speed
    force, flow = force_n * slower**2, flow * slower
    columns = []
    for value in np.unique(angle):
        here = angle == value
        flows, place = np.unique(np.round(flow[here], 9), return_inverse=True)
        bins = np.arange(flows.size) if flows.size <= _MOST_KNOTS else np.arange(flows.size) * _MOST_KNOTS // flows.size
        of = bins[place.ravel()]
        count = np.bincount(of)
        blocks = [
            [f, m, n]
            for f, m, n in zip(np.bincount(of, force[here]) / count, np.bincount(of, flow[here]) / count, count, strict=True)
        ]
        columns.append(_rising(float(value), blocks))
    return LookUpTable(machine.nominal_elevator_speed_rad_s, tuple(columns))


def _rising(angle_rad: float, blocks: list[list[float]]) -> TableColumn:
    """One column of the table from (force, flow, weight) blocks in order of flow; neighbours with falling force are merged."""
    kept: list[list[float]] = []
    for block in blocks:
        kept.append(list(block))
        while len(kept) > 1 and kept[-1][0] <= kept[-2][0]:
            f, m, n = kept.pop()
            below = kept[-1]
            whole = below[2] + n
            kept[-1] = [(below[0] * below[2] + f * n) / whole, (below[1] * below[2] + m * n) / whole, whole]
    return TableColumn(angle_rad, tuple(float(b[0]) for b in kept), tuple(float(b[1]) for b in kept))


def _one_each(angle: Array) -> Array:
    """The angles, each group within SAME_ANGLE_RAD replaced by its mean."""
    out = angle.copy()
    order = np.argsort(angle, kind="stable")
    start = 0
    for end in range(1, order.size + 1):
        if end == order.size or angle[order[end]] - angle[order[start]] > SAME_ANGLE_RAD:
            out[order[start:end]] = angle[order[start:end]].mean()
            start = end
    return out


def _inner(load: Array) -> NDArray[np.bool_]:
    """Which cells belong to neither the lightest nor the heaviest load, since a curve without these would be extrapolated; all
    cells if there are few loads."""
    if np.unique(load).size < _LEAST_INNER + 2:
        return np.ones(load.size, dtype=bool)
    return np.asarray((load > load.min()) & (load < load.max()))


def _relative(left_out: Array, fitted: Array, inner: NDArray[np.bool_]) -> float:
    """Relative standard deviation of a flow within the range.

    The larger of the rms errors of inner loads left out and of all loads fitted, at least LEAST_RELATIVE_STD_DEV; 1 if the curve
    gives no flow for a load.
    """
    if not (np.all(np.isfinite(left_out[inner])) and np.all(np.isfinite(fitted))):
        return 1.0
    return float(max(LEAST_RELATIVE_STD_DEV, np.sqrt(np.mean(left_out[inner] ** 2)), np.sqrt(np.mean(fitted**2))))
