"""The sweeps in a daemon's store as a measurement table, for `yieldmon diagnose`.

One row for each visit of each whole sweep: the mean force of its windows over the flow that the visits home around it give. What
the table cannot know is the scale: the flow is what the given parameters make of the force at the home angle, so an effect that
acts alike at every angle does not show, and the load's own curve at home is the parameters' own.

Conditions that are meant to be the same are brought together: visits to one angle, speeds within 2 %, moisture within 2 points,
and flows on steps of 10 %, to which the force is carried by the parameters' own model over no more than half a step.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yieldmon.errors import InputError
from yieldmon.estimation.clusters import cluster, meant_conditions
from yieldmon.estimation.fitting.scatter_law import scatter_law
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.home_flow import AwayVisits, covariance, wander_per_s
from yieldmon.estimation.self_calibration.sweep_flow import SweepWindows, WindowFlows, window_flows
from yieldmon.estimation.self_calibration.sweep_flow import force_n as model_force_n
from yieldmon.files import parameter_file
from yieldmon.files.table import Table
from yieldmon.physics.machine import RPM, SAME_ANGLE_RAD, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.service.logs.recorded import changed_at, opened
from yieldmon.service.storage.rows import SecondRow
from yieldmon.units import counted

LEAST_ANGLES = 4
_LEAST_DOF = 20
_LEAST_POWER = 0.2
"""Of force by flow at home: where it is flatter, flow says little."""


@dataclass(frozen=True)
class SweepTable:
    """What a store says of its sweeps.

    table: rows fit for `diagnose`. text: the same as CSV. sweeps: how many are in it. scale_sd: relative standard deviation of
    all its flows together, from the parameters that they rest on.
    """

    table: Table
    text: str
    sweeps: int
    scale_sd: float


@dataclass(frozen=True)
class _Sweep:
    """One sweep with the step of each window, (windows,)."""

    sweep_id: int
    step: NDArray[np.int64]
    windows: SweepWindows


@dataclass(frozen=True)
class _Visit:
    """Mean of the windows of one step. relative_sd: of force and bracketing flow together."""

    sweep_id: int
    angle_rad: float
    speed_rad_s: float
    flow_kg_s: float
    force_n: float
    relative_sd: float
    moisture_pct: float


def given_parameters(path: Path | str) -> ParameterSet:
    """The parameters that the daemon was given last, without what sweeps changed since: that rests on the model in question.

    Raises InputError when the store holds none.
    """
    with opened(Path(path)) as store:
        given = [v.document for v in store.parameter_versions() if v.origin in (ParameterOrigin.FILE, ParameterOrigin.HARDWARE)]
    if not given:
        raise InputError(str(path), "holds no parameters that came from a file", "such parameters, or --params P.yaml")
    return parameter_file.from_document(given[-1], str(path))


def read(path: Path | str, machine: Machine, parameters: ParameterSet, last: int | None = None) -> SweepTable:
    """The sweeps in a store since the machine was changed, the `last` ones only where that is given; parameters make flow of the
    force at home.

    Raises InputError when it is no store of this version or an older one, or its sweeps do not say enough.
    """
    with opened(Path(path)) as store:
        since = changed_at(store)
        rows = [row for row in store.seconds_of_sweeps() if row.parameter_version >= since]
    return of_seconds([rows], str(path), machine, parameters, last)


def of_seconds(
    records: Sequence[Sequence[SecondRow]], where: str, machine: Machine, parameters: ParameterSet, last: int | None = None
) -> SweepTable:
    """The table of one or several records' seconds that count for a sweep; where: for errors. See `read`.

    The sweeps of several records are numbered anew. Raises InputError where no sweep can be used.
    """
    every = [sweep for rows in records for sweep in _by_sweep([_values(row) for row in rows if _usable(row)])]
    if len(records) > 1:
        every = [replace(sweep, sweep_id=number) for number, sweep in enumerate(every, 1)]
    sweeps = every[-last if last is not None else 0 :]
    if not sweeps:
        raise InputError(where, "holds no sweep", "a store in which a sweep of the plate was measured")
    model = ForwardModel(machine, parameters.effects)
    visits = _visits(sweeps, model, parameters)
    angle_deg = _same(np.degrees([v.angle_rad for v in visits]), np.degrees(SAME_ANGLE_RAD))
    angles = np.unique(angle_deg)
    if angles.size < LEAST_ANGLES:
        found = ", ".join(f"{a:g}" for a in angles) or "none"
        raise InputError(
            where, f"has sweeps with a known flow at {angles.size} plate angles ({found} deg)", f"at least {LEAST_ANGLES}"
        )
    columns = _standardised(visits, angle_deg, model, parameters)
    # A visit's few windows say little of their own scatter: weights made of it would favour what happens to agree.
    constant, proportional = scatter_law(columns["force_n"], columns["sigma"] * _scatter_over_stated(columns))
    columns["sigma"] = np.hypot(constant, proportional * columns["force_n"])
    trial = tuple(str(v.sweep_id) for v in visits)
    text = _csv(columns, trial)
    used = len(set(trial))
    scale_sd = _scale_sd(visits, model, parameters)
    note = (
        f"{where}: {counted(len(visits), 'visit')} in {counted(used, 'sweep')}; the flow is what "
        f"version {parameters.version} of the parameters makes of the force at the home angle, "
        f"so the scale of flow and gain is theirs (good to {100.0 * scale_sd:.1f} %)"
    )
    table = Table(
        where, hashlib.sha256(text.encode()).hexdigest(), "mass_flow_kg_s", "force_n", columns, {"trial": trial}, (note,)
    )
    return SweepTable(table, text, used, scale_sd)


def away_of_seconds(records: Sequence[Sequence[SecondRow]], machine: Machine, parameters: ParameterSet) -> tuple[AwayVisits, ...]:
    """What each sweep of one or several records measured away from home; sweeps without a known flow are left out."""
    sweeps = [sweep for rows in records for sweep in _by_sweep([_values(row) for row in rows if _usable(row)])]
    model = ForwardModel(machine, parameters.effects)
    flows = [
        _with_flow_sd(found, model, parameters, sweep)
        for found, sweep in zip(window_flows(model, parameters, [sweep.windows for sweep in sweeps]), sweeps, strict=True)
    ]
    wander = wander_per_s([found.visits for found in flows])
    found = (_away(sweep, flow, wander, machine) for sweep, flow in zip(sweeps, flows, strict=True))
    return tuple(away for away in found if len(away))


def _with_flow_sd(found: WindowFlows, model: ForwardModel, parameters: ParameterSet, sweep: _Sweep) -> WindowFlows:
    """The visits with the deviation of their flow instead of that of their force, of which flow is no straight function."""
    flow = np.exp(found.visits.log_flow)
    if not flow.size:
        return found
    w, home = sweep.windows, np.full(flow.size, model.machine.home_plate_angle_rad)
    speed = float(np.median(w.elevator_speed_rad_s))
    more, less = (model_force_n(model, parameters.values, home, speed, flow * by, w.moisture_pct) for by in (1.01, 0.99))
    power = np.log(more / less) / np.log(1.01 / 0.99)
    power = np.where(np.isfinite(power), np.maximum(power, _LEAST_POWER), 1.0)
    return replace(found, visits=replace(found.visits, sd=found.visits.sd / power))


def _away(sweep: _Sweep, found: WindowFlows, wander: float, machine: Machine) -> AwayVisits:
    w = sweep.windows
    usable = np.isfinite(found.log_flow) & ~w.at_home(machine.home_plate_angle_rad)
    steps, number = np.unique(sweep.step[usable], return_inverse=True)
    count = np.bincount(number, minlength=steps.size)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(number, values[usable], minlength=steps.size) / count)

    noise = np.bincount(number, w.relative_sd[usable] ** 2, minlength=steps.size) / count**2
    return AwayVisits(
        plate_angle_rad=mean(w.plate_angle_rad),
        elevator_speed_rad_s=mean(w.elevator_speed_rad_s),
        mass_flow_kg_s=np.exp(mean(found.log_flow)),
        force_n=mean(w.force_n),
        moisture_pct=w.moisture_pct,
        force_variance=noise,
        flow_covariance=covariance(found.visits, mean(w.time_s), wander),
    )


def _usable(row: SecondRow) -> bool:
    force = row.force_n or 0.0, row.force_std_dev_n or 0.0
    return row.plate_angle_deg is not None and (row.elevator_speed_rpm or 0.0) > 0.0 and min(force) > 0.0


def _values(row: SecondRow) -> tuple[float | None, ...]:
    return (
        row.sweep_id, row.sweep_step, row.time_s, row.plate_angle_deg, row.elevator_speed_rpm, row.force_n, row.force_std_dev_n,
        row.moisture_pct,
    )  # fmt: skip


def _by_sweep(rows: Sequence[tuple[float | None, ...]]) -> list[_Sweep]:
    if not rows:
        return []
    values = np.array([[np.nan if v is None else v for v in row] for row in rows], dtype=float)
    sweep_id = values[:, 0].astype(int)
    # Ids begin anew in a store whose state was lost: a run of one id is one sweep.
    starts = np.flatnonzero(np.diff(sweep_id, prepend=-1))
    out = []
    for part in np.split(values, starts[1:]):
        _, step, time_s, angle, rpm, force, sd, moisture = part.T
        known = moisture[np.isfinite(moisture)]
        moisture_pct = float(np.median(known)) if known.size else float("nan")
        windows = SweepWindows(time_s, np.radians(angle), rpm * RPM, force, sd / force, moisture_pct)
        out.append(_Sweep(int(part[0, 0]), step.astype(int), windows))
    return out


def _visits(sweeps: Sequence[_Sweep], model: ForwardModel, parameters: ParameterSet) -> list[_Visit]:
    """Visits whose flow is known from visits home before and after."""
    flows = window_flows(model, parameters, [sweep.windows for sweep in sweeps])
    out = []
    for sweep, found in zip(sweeps, flows, strict=True):
        w = sweep.windows
        for step in np.unique(sweep.step):
            here = (sweep.step == step) & np.isfinite(found.log_flow)
            if not np.any(here):
                continue
            noise = float(np.sqrt(np.sum(w.relative_sd[here] ** 2))) / np.count_nonzero(here)
            out.append(
                _Visit(
                    sweep_id=sweep.sweep_id,
                    angle_rad=float(np.mean(w.plate_angle_rad[here])),
                    speed_rad_s=float(np.mean(w.elevator_speed_rad_s[here])),
                    flow_kg_s=float(np.exp(np.mean(found.log_flow[here]))),
                    force_n=float(np.mean(w.force_n[here])),
                    relative_sd=float(np.hypot(noise, np.mean(found.sd[here]))),
                    moisture_pct=w.moisture_pct,
                )
            )
    return out


def _standardised(visits: Sequence[_Visit], angle_deg: Array, model: ForwardModel, parameters: ParameterSet) -> dict[str, Array]:
    """Columns of the table, with each force carried to the nearest of the conditions that are meant to be the same."""
    angle, speed, flow, force, relative_sd, moisture = (
        np.array([getattr(v, name) for v in visits])
        for name in ("angle_rad", "speed_rad_s", "flow_kg_s", "force_n", "relative_sd", "moisture_pct")
    )
    nominal = model.machine.nominal_elevator_speed_rad_s
    near_speed, near_flow, near_moisture = meant_conditions(speed, nominal, flow, moisture)
    there = model_force_n(model, parameters.values, angle, near_speed, near_flow, moisture)
    here = model_force_n(model, parameters.values, angle, speed, flow, moisture)
    # Beyond the model's full paddle its slope is no help; force goes about as flow and speed.
    plain = near_flow * near_speed / (flow * speed)
    ratio = np.divide(there, here, out=plain, where=np.isfinite(there) & np.isfinite(here) & (here > 0.0))
    carried = force * ratio
    return {
        "plate_angle_deg": angle_deg,
        "mass_flow_kg_s": np.round(near_flow, 4),
        "elevator_speed_rpm": np.round(near_speed / RPM, 2),
        "force_n": carried,
        "sigma": carried * relative_sd,
        "moisture_pct": near_moisture,
    }


def _scatter_over_stated(columns: dict[str, Array]) -> float:
    """Scatter of the rows under the same conditions over what is stated; 1 where too few repeat each other to say."""
    names = ("plate_angle_deg", "mass_flow_kg_s", "elevator_speed_rpm", "moisture_pct")
    keys = np.nan_to_num(np.stack([columns[name] for name in names], axis=-1), nan=-1.0)
    _, cell = np.unique(keys, axis=0, return_inverse=True)
    cell = cell.ravel()
    weight = columns["sigma"] ** -2.0
    mean = np.bincount(cell, weight * columns["force_n"]) / np.bincount(cell, weight)
    dof = cell.size - int(cell.max()) - 1
    if dof < _LEAST_DOF:
        return 1.0
    return float(np.sqrt(np.sum(weight * (columns["force_n"] - mean[cell]) ** 2) / dof))


def _scale_sd(visits: Sequence[_Visit], model: ForwardModel, parameters: ParameterSet) -> float:
    """Relative standard deviation that the parameters' covariance leaves on the flow at home, at the visits' mean flow."""
    machine = model.machine
    flow, moisture = float(np.mean([v.flow_kg_s for v in visits])), float(np.mean([v.moisture_pct for v in visits]))
    at = (machine.home_plate_angle_rad, machine.nominal_elevator_speed_rad_s)
    conditions = Conditions(*at, mass_flow_kg_s=flow, moisture_pct=moisture)
    force = float(np.real(model.force(conditions, parameters.values)))
    estimate = OpenLoop(model, parameters).estimate(force, *at, moisture_pct=moisture)
    return float(estimate.std_dev_kg_s) / flow


def _same(values: Array, width: float) -> Array:
    """Each value replaced by the mean of its cluster, to a tenth."""
    number = cluster(values, width)
    return np.asarray(np.round(np.bincount(number, values) / np.bincount(number), 1)[number])


def _csv(columns: dict[str, Array], trial: Sequence[str]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*columns, "trial"])
    for values, name in zip(zip(*columns.values(), strict=True), trial, strict=True):
        writer.writerow([*("nan" if np.isnan(v) else f"{v:.6g}" for v in values), name])
    return out.getvalue()
