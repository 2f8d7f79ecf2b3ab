"""Plan of the next experiment: rows that separate tied explanations, within what the machine can run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from yieldmon.physics.effects import family_of
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import COMPLEX_STEP, Array, real

from .fit import Fit
from .noise import Noise

_FLOWS_KG_S = (1.0, 2.0, 5.0, 9.0, 14.0, 20.0)
REPEATS = 3
"""Number of repetitions of each planned row."""


@dataclass(frozen=True)
class PlannedRow:
    """One condition to run; SI and radians."""

    plate_angle_rad: float
    mass_flow_kg_s: float
    elevator_speed_rad_s: float


@dataclass(frozen=True)
class Plan:
    """Rows to run (each `REPEATS` times), the pairs of effects that they separate, and the power of this at the 5 % level, for
    the hardest pair and for each."""

    rows: tuple[PlannedRow, ...]
    separates: tuple[tuple[str, str], ...]
    power: float
    powers: tuple[float, ...] = ()


def plan(best: Fit, rivals: Sequence[Fit], noise: Noise, *, rows: int = 8) -> Plan:
    """Greedy choice of `rows` conditions that maximise the smallest separation between the best model and its rivals.

    The separation is the expected chi-square of a rival, recalibrated on old and new rows, if the best model is true. The power
    follows from the noncentral chi-square distribution with one degree of freedom.
    """
    if not rivals:
        return Plan((), (), 0.0)
    grid = _grid(best, rivals)
    truth, _ = _with_jacobian(best, grid)
    usable = np.isfinite(truth)
    forms = []
    for rival in rivals:
        prediction, jacobian = _with_jacobian(rival, grid)
        usable &= np.isfinite(prediction)
        forms.append((rival, prediction, jacobian))
    if not np.any(usable):
        return Plan((), (), 0.0)
    sd = noise.sd(truth) / np.sqrt(REPEATS)
    states = []
    for rival, prediction, jacobian in forms:
        scale = np.array([p.scale for p in rival.parameters])
        old_j, old_d = rival.jacobian * scale, rival.residual - best.residual
        new_j = np.where(usable[:, None], jacobian * scale / sd[:, None], 0.0)
        new_d = np.where(usable, (prediction - truth) / sd, 0.0)
        ridge = 1e-9 * np.trace(old_j.T @ old_j) / len(scale) * np.eye(len(scale))
        states.append([old_j.T @ old_j + ridge, old_j.T @ old_d, float(old_d @ old_d), new_j, new_d])
    chosen: list[int] = []
    for _ in range(rows):
        gains = np.stack([separation_with(*state) for state in states])
        worst = np.where(usable, np.min(np.minimum(gains, 60.0), axis=0) + 1e-3 * np.mean(gains, axis=0), -np.inf)
        i = int(np.argmax(worst))
        if not np.isfinite(worst[i]):
            break
        chosen.append(i)
        usable[i] = False
        for state in states:
            j, d = state[3][i], state[4][i]
            state[0], state[1], state[2] = state[0] + np.outer(j, j), state[1] + j * d, state[2] + float(d * d)
    separation = [max(s[2] - float(s[1] @ np.linalg.solve(s[0], s[1])), 0.0) for s in states]
    power = scipy.stats.ncx2.sf(scipy.stats.chi2.isf(0.05, 1), 1, np.maximum(separation, 1e-12))
    picked = tuple(
        PlannedRow(float(grid.plate_angle_rad[i]), float(grid.mass_flow_kg_s[i]), float(grid.elevator_speed_rad_s[i]))
        for i in sorted(set(chosen))
    )
    pairs: dict[tuple[str, str], float] = {}
    for rival, found in zip(rivals, np.atleast_1d(power), strict=True):
        pair = _different(best, rival)
        pairs[pair] = min(pairs.get(pair, 1.0), float(found))
    names = sorted(pairs)
    return Plan(picked, tuple(names), float(np.min(power)), tuple(pairs[name] for name in names))


def _different(best: Fit, rival: Fit) -> tuple[str, str]:
    ours = [family_of(e) for e in best.effects if e not in rival.effects]
    theirs = [family_of(e) for e in rival.effects if e not in best.effects]
    return "+".join(ours), "+".join(theirs)


def separation_with(information: Array, moment: Array, square: float, jacobian: Array, difference: Array) -> Array:
    """Separation after one more row, for every row of the grid, (rows,), by a rank-one update in closed form.

    information, moment, square: J'J, J'd and d'd of the old rows, whitened; J: derivatives of the rival, d: its difference from
    the best model. jacobian (rows, parameters), difference (rows,): those of the new rows.
    """
    inverse = np.linalg.inv(information)
    now = square - float(moment @ inverse @ moment)
    leverage = np.einsum("ij,jk,ik->i", jacobian, inverse, jacobian)
    unexplained = difference - jacobian @ (inverse @ moment)
    return np.asarray(now + unexplained**2 / (1.0 + leverage))


@dataclass(frozen=True)
class _Grid:
    plate_angle_rad: Array
    mass_flow_kg_s: Array
    elevator_speed_rad_s: Array


def _grid(best: Fit, rivals: Sequence[Fit]) -> _Grid:
    machine = best.frame.cells.rows.machine
    angles = np.linspace(machine.min_plate_angle_rad, machine.max_plate_angle_rad, 6)
    nominal = machine.nominal_elevator_speed_rad_s
    low = max(machine.min_elevator_speed_rad_s, 0.75 * nominal)
    high = min(machine.max_elevator_speed_rad_s, 1.25 * nominal)
    speeds = np.array([low, 0.5 * (low + nominal), nominal, 0.5 * (nominal + high), high])
    smallest = min(f.values["density"] * f.values["shape_ratio"] for f in (best, *rivals))
    full_kg = 0.5 * smallest * machine.paddle_width_m * (0.8 * machine.paddle_length_m) ** 2
    most = 0.95 * full_kg * machine.passes_per_s(low)
    flows = np.array([f for f in _FLOWS_KG_S if f <= most] or [0.5 * most])
    a, f, s = np.meshgrid(angles, flows, speeds, indexing="ij")
    return _Grid(a.ravel(), f.ravel(), s.ravel())


def _with_jacobian(fitted: Fit, grid: _Grid) -> tuple[Array, Array]:
    frame = fitted.frame
    model = ForwardModel(frame.cells.rows.machine, (*frame.known, *fitted.effects), nodes=frame.nodes)
    moisture = float(np.nanmedian(frame.cells.moisture_pct)) if np.any(np.isfinite(frame.cells.moisture_pct)) else np.nan
    conditions = Conditions(
        grid.plate_angle_rad, grid.elevator_speed_rad_s, mass_flow_kg_s=grid.mass_flow_kg_s, moisture_pct=moisture
    )
    if not np.isfinite(moisture):
        conditions = replace(conditions, moisture_pct=None)
    evaluate = model.force if frame.cells.rows.of == "force" else model.paddle_momentum
    names = [p.name for p in fitted.parameters]
    moved = fitted.x[:, None] + 1j * COMPLEX_STEP * np.eye(len(names))
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        values = np.asarray(
            evaluate(conditions, dict(frame.fixed) | {n: moved[i][:, None] for i, n in enumerate(names)}, overfull="nan")
        )
    values = np.broadcast_to(values, (len(names), len(grid.mass_flow_kg_s)))
    return real(values[0]), np.nan_to_num(np.imag(values).T / COMPLEX_STEP)
