"""Sweeps of many machines on one lattice of angle, speed and load, where they can be compared.

A load is identified by the force at home. Forces of machines with different gains, known from tickets, are converted to one gain.
Remaining differences at equal force at home, angle and speed are those of the machines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yieldmon.discrepancy.base_fit import base_frame
from yieldmon.discrepancy.frame import FINAL_NODES, Following, Frame
from yieldmon.discrepancy.observations import Rows, cells
from yieldmon.estimation.clusters import cluster, meant_conditions
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.home_flow import AwayVisits
from yieldmon.physics.machine import SAME_ANGLE_RAD, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array, real

_ERROR = 0.01
"""Relative standard deviation of a cell without information."""


@dataclass(frozen=True)
class Placed:
    """One machine's visits on the lattice, from complete sweeps: ln(force) converted to the cell, and the cell's number,
    (visits,).

    whiten: blocks of (first visit, inverse Cholesky factor).
    """

    name: str
    log_force: Array
    cell: NDArray[np.int64]
    blocks: tuple[tuple[int, Array], ...]

    def whitened(self, values: Array) -> Array:
        """Whitened columns of visits, (visits,) or (visits, columns)."""
        return np.concatenate([factor @ values[first : first + len(factor)] for first, factor in self.blocks])


@dataclass(frozen=True)
class Lattice:
    """Machines on one lattice.

    frame: its cells with the model, with loads that depend on the parameters; the cells' values are not yet measurements. grain:
    initial parameters of the model.
    """

    frame: Frame
    machines: tuple[Placed, ...]
    grain: Mapping[str, float]


def reference_force_n(model: ForwardModel, parameters: ParameterSet, flow_kg_s: float, moisture_pct: float) -> float:
    """Force at home and nominal speed, with which gains of machines are compared."""
    at = Conditions(
        model.machine.home_plate_angle_rad, model.machine.nominal_elevator_speed_rad_s, mass_flow_kg_s=flow_kg_s,
        moisture_pct=moisture_pct,
    )  # fmt: skip
    return float(np.real(model.force(at, parameters.values)))


def with_force(
    model: ForwardModel, parameters: ParameterSet, force_n: float, flow_kg_s: float, moisture_pct: float
) -> ParameterSet:
    """The parameters with the restitution that gives the force at home at a flow."""
    values = dict(parameters.values)
    for _ in range(3):
        here = reference_force_n(model, replace(parameters, values=values), flow_kg_s, moisture_pct)
        more = values | {"restitution": 1.01 * (1.0 + values["restitution"]) - 1.0}
        there = reference_force_n(model, replace(parameters, values=more), flow_kg_s, moisture_pct)
        values["restitution"] += (force_n - here) / (there - here) * 0.01 * (1.0 + values["restitution"])
    return replace(parameters, values=values)


def lay(
    machine: Machine, parameters: ParameterSet, reference_kg_s: float, sweeps: Sequence[tuple[str, Sequence[AwayVisits]]]
) -> Lattice:
    """Build the lattice of machines of one geometry. Forces have the gain of `parameters`, with which flows were measured."""
    model = ForwardModel(machine, parameters.effects)
    every = [sweep for _, of_machine in sweeps for sweep in of_machine]
    angle, speed, flow = (
        np.concatenate([getattr(s, n) for s in every]) for n in ("plate_angle_rad", "elevator_speed_rad_s", "mass_flow_kg_s")
    )
    moisture = np.concatenate([np.full(len(s.force_n), s.moisture_pct) for s in every])
    number = cluster(angle, SAME_ANGLE_RAD)
    near = (
        (np.bincount(number, angle) / np.bincount(number))[number],
        *meant_conditions(speed, machine.nominal_elevator_speed_rad_s, flow, moisture),
    )
    keys = np.stack([near[0], near[1], near[2], np.nan_to_num(near[3], nan=-1.0)], axis=-1)
    _, first, cell = np.unique(np.round(keys, 9), axis=0, return_index=True, return_inverse=True)
    cell = cell.ravel()

    def force(angle: Array, speed: Array, flow: Array, moisture: Array) -> Array:
        where = Conditions(angle, speed, mass_flow_kg_s=flow, moisture_pct=moisture)
        return real(np.asarray(model.force(where, parameters.values, overfull="nan")))

    # Beyond a full paddle the model has no slope; the force is about proportional to flow and speed.
    with np.errstate(invalid="ignore", divide="ignore"):
        here = force(angle, speed, flow, moisture)
        ratio = force(*near) / here
        power = np.log(here / force(angle, speed, 0.99 * flow, moisture)) / np.log(1.0 / 0.99)
    power = np.where(np.isfinite(power), power, 1.0)
    carried = np.where(np.isfinite(ratio) & (ratio > 0.0), ratio, near[2] * near[1] / (flow * speed))
    log_force = np.log(np.concatenate([s.force_n for s in every]) * carried)
    # The model's value replaces a measurement, so that no cell is empty.
    shown = force(*(values[first] for values in near))
    level = np.where(np.isfinite(shown), shown, np.bincount(cell, np.exp(log_force)) / np.bincount(cell))
    rows = Rows(
        machine,
        load_name="mass_flow_kg_s",
        of="force",
        si=True,
        plate_angle_rad=near[0][first],
        elevator_speed_rad_s=near[1][first],
        load=near[2][first],
        moisture_pct=near[3][first],
        value=level,
        sigma=_ERROR * level,
        trial=("",) * first.size,
        cell=np.arange(first.size),
    )
    grouped = cells(rows)
    frame = base_frame(grouped, _ERROR * grouped.mean, parameters, "restitution", keep_effects=True)
    fixed = {**frame.fixed, "restitution": parameters.values["restitution"]}
    base = tuple(p for p in frame.base if p.name != "restitution")
    reference_moisture = float(np.nanmedian(moisture)) if np.any(np.isfinite(moisture)) else float("nan")
    followed = _following(model, parameters, frame, reference_kg_s, reference_moisture)
    placed = _placed(sweeps, log_force, power, cell)
    return Lattice(replace(frame, base=base, fixed=fixed, following=followed), placed, parameters.values)


def _placed(
    sweeps: Sequence[tuple[str, Sequence[AwayVisits]]], log_force: Array, power: Array, cell: NDArray[np.int64]
) -> tuple[Placed, ...]:
    """The machines, from columns of all visits in order. power: d ln(force) / d ln(flow)."""
    placed, at = [], 0
    for name, of_machine in sweeps:
        blocks, start = [], at
        for sweep in of_machine:
            slope = power[at : at + len(sweep.force_n)]
            covariance = np.diag(sweep.force_variance) + np.outer(slope, slope) * sweep.flow_covariance
            blocks.append((at - start, np.linalg.inv(np.linalg.cholesky(covariance))))
            at += len(sweep.force_n)
        placed.append(Placed(name, log_force[start:at], cell[start:at], tuple(blocks)))
    return tuple(placed)


def _following(
    model: ForwardModel, parameters: ParameterSet, frame: Frame, reference_kg_s: float, moisture_pct: float
) -> Following:
    layout = frame.cells.layout
    loads, column = np.unique(layout.load, return_inverse=True)
    keys = np.concatenate((layout.elevator_speed_rad_s, layout.moisture_pct), axis=1)
    _, first, row = np.unique(np.nan_to_num(keys, nan=-1.0), axis=0, return_index=True, return_inverse=True)
    nominal = model.machine.nominal_elevator_speed_rad_s
    speed = np.concatenate((layout.elevator_speed_rad_s[first], [[nominal]]))
    moisture = np.concatenate((layout.moisture_pct[first], [[moisture_pct]]))
    flow = np.concatenate((np.broadcast_to(loads, (first.size, loads.size)), np.full((1, loads.size), reference_kg_s)))
    exact = ForwardModel(model.machine, model.effects, nodes=FINAL_NODES)

    def force(flow: Array) -> Array:
        where = Conditions(model.machine.home_plate_angle_rad, speed, mass_flow_kg_s=flow, moisture_pct=moisture)
        return real(np.asarray(exact.force(where, parameters.values, overfull="nan")))

    there = force(flow)
    with np.errstate(invalid="ignore"):
        power = (np.log(force(0.999 * flow) / there) / np.log(0.999))[:-1]
    place = row.ravel()[:, None] * loads.size + column.reshape(layout.load.shape)
    reference = float(there[-1, 0])
    return Following(speed, moisture, flow, there[:-1] / reference, np.where(np.isfinite(power), power, 1.0), reference, place)
