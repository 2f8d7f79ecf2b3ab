"""Measured loads with their tickets.

A ticket names loads by their numbers; a log with one load may be named instead. Each second of a load counts with the time for
which its flow, by the parameters that measured it, gives its mass.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from yieldmon.errors import InputError
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.files.ticket_file import COLUMNS, WeighedTicket, names_log, unit_slip
from yieldmon.files.ticket_parts import with_parts_added
from yieldmon.physics.machine import RPM, Machine
from yieldmon.service.logs.force_seconds import ForceSeconds, force_seconds, known_seconds
from yieldmon.service.logs.measured_loads import MeasuredLoad
from yieldmon.service.storage.rows import SecondRow

LEAST_KNOWN_SHARE = 0.9
"""Share of a load's mass that must rest on a known force, angle and speed."""
_KEPT_SWEEPS = 20
_TELLING_SECONDS, _LEAST_SECONDS = 300, 20


def alike(loads: Sequence[MeasuredLoad], tickets: Sequence[WeighedTicket]) -> tuple[MeasuredLoad, ...]:
    """The loads of the crop that the tickets are for, all others left out. Raises InputError where those are of two crops."""
    first: MeasuredLoad | None = None
    for ticket in tickets:
        for load in loads_on(ticket, loads):
            if first is None or not first.crop:
                first = load
            elif load.crop and load.crop != first.crop:
                raise InputError(
                    ticket.where,
                    f"load {load.name} is of {load.crop}, load {first.name} of {first.crop}",
                    "the tickets of one crop in a file",
                )
    return tuple(load for load in loads if first is None or load.crop == first.crop)


def match(loads: Sequence[MeasuredLoad], tickets: Sequence[WeighedTicket], machine: Machine) -> tuple[WeighedLoad, ...]:
    """Each ticket with the seconds of its loads. Raises InputError for a ticket without a load, or with one that has another."""
    out = []
    for ticket, covered in each_on_one(loads, tickets):
        for load in covered:
            if load.is_open:
                problem = f"load {load.name} is still open, so more grain may come"
                raise InputError(
                    ticket.where,
                    problem,
                    "`yieldmon load stop` first, with the daemon running, or the tickets of the other loads",
                )
            if load.before_change:
                problem = f"load {load.name} was measured before the machine was changed (`yieldmon calibrations restart`)"
                raise InputError(ticket.where, problem, "tickets of loads after it")
        out.append(_weighed(ticket.name, ticket, covered, machine))
    return tuple(out)


def each_on_one(
    loads: Sequence[MeasuredLoad], tickets: Sequence[WeighedTicket]
) -> list[tuple[WeighedTicket, tuple[MeasuredLoad, ...]]]:
    """Each ticket with its loads, parts of a load added. Raises InputError as `loads_on` and `with_parts_added`."""
    by_name = {load.name: load for load in loads}
    named = [(ticket, [load.name for load in loads_on(ticket, loads)]) for ticket in tickets]
    return [(ticket, tuple(by_name[name] for name in names)) for ticket, names in with_parts_added(named)]


def loads_on(ticket: WeighedTicket, loads: Sequence[MeasuredLoad]) -> list[MeasuredLoad]:
    """The loads that a ticket is for. Raises InputError where there is none such."""
    names = [load.name for load in loads]
    if ticket.first in names and ticket.last in names:
        first, last = names.index(ticket.first), names.index(ticket.last)
        if last < first:
            raise InputError(ticket.where, f"is {ticket.first}-{ticket.last}", "the first load first")
        return list(loads[first : last + 1])
    wanted = Path(ticket.first).name
    of_log = [load for load in loads if load.log and names_log(ticket.first, load.log)]
    if len(of_log) == 1:
        return of_log
    if len(of_log) > 1:
        held = ", ".join(load.name for load in of_log)
        raise InputError(ticket.where, f"{wanted} holds {len(of_log)} loads", f"one of the numbers {held}")
    known = f"{names[0]} to {names[-1]}" if names else "none was measured"
    raise InputError(ticket.where, f"is {ticket.first}, no load that was measured", known)


def _weighed(name: str, ticket: WeighedTicket, covered: Sequence[MeasuredLoad], machine: Machine) -> WeighedLoad:
    for load in covered:
        if load.unmeasured_share > 1.0 - LEAST_KNOWN_SHARE:
            share = f"{100.0 * load.unmeasured_share:.0f} % of its time"
            raise InputError(
                ticket.where,
                f"{load.unmeasured_s:.0f} s of load {load.name}, {share}, were not measured",
                f"at most {100.0 * (1.0 - LEAST_KNOWN_SHARE):.0f} %; a load measured whole",
            )
    total_kg = sum(load.mass_kg for load in covered)
    if slip := unit_slip(ticket.mass_kg, total_kg):
        expected = (
            f"the masses in the unit of their column: {COLUMNS}; or, where all loads are off by one factor, the force cell's own "
            "sensor.gain_n_per_mv in the machine file"
        )
        raise InputError(ticket.where, f"load {name} {slip}", expected)
    for load in covered:
        for version in sorted({row.parameter_version for row in load.seconds} - set(load.parameters)):
            problem = f"load {load.name} was measured with parameters version {version}"
            raise InputError(ticket.where, problem, "a store that still holds them")
    known = ForceSeconds.joined(known_seconds(load.seconds, load.parameters, machine) for load in covered)
    known_kg = float(known.mass_kg.sum())
    if known_kg < LEAST_KNOWN_SHARE * total_kg:
        raise InputError(
            ticket.where,
            f"of load {name} only {100.0 * known_kg / total_kg:.0f} % rests on a known force, angle and speed",
            f"{100.0 * LEAST_KNOWN_SHARE:.0f} %; a load measured whole",
        )
    # The small rest, whose force is unknown, is taken to be spread over time like the known part.
    return WeighedLoad(
        name=name,
        weighed_kg=ticket.mass_kg,
        std_dev_kg=ticket.std_dev_kg,
        duration_s=known.duration_s * total_kg / known_kg,
        force_n=known.force_n,
        plate_angle_rad=known.plate_angle_rad,
        elevator_speed_rad_s=known.elevator_speed_rad_s,
        moisture_pct=known.moisture_pct if np.all(np.isfinite(known.moisture_pct)) else None,
        noise_sd=_noise_sd(covered, total_kg),
        common_kg=ticket.other_std_dev_kg,
    )


def _noise_sd(covered: Sequence[MeasuredLoad], total_kg: float) -> float:
    """Relative, of the loads' mass, by the windows' scatter; windows without one, as older stores hold them, count as exact."""
    rows = [row for load in covered for row in load.seconds if row.noise_std_dev_kg_s is not None]
    return float(np.sqrt(sum((row.noise_std_dev_kg_s * row.duration_s) ** 2 for row in rows))) / total_kg


def times_what_a_machine_makes(loads: Sequence[MeasuredLoad], machine: Machine) -> float | None:
    """Masses of a store's newest seconds over what a machine makes of their forces by the parameters that measured them: 1 with
    the machine that did. None for logs, and where too few seconds tell."""
    found: list[np.ndarray] = []
    for load in [load for load in reversed(loads) if not load.log]:
        of_version: dict[int, list[SecondRow]] = {}
        for row in load.seconds[-_TELLING_SECONDS:]:
            of_version.setdefault(row.parameter_version, []).append(row)
        for version, rows in of_version.items():
            if version in load.parameters:
                seconds = force_seconds(rows, load.parameters[version], machine)
                found.append(seconds.duration_s / [row.duration_s for row in rows])
        if sum(map(len, found)) >= _TELLING_SECONDS:
            break
    times = np.concatenate([np.zeros(0), *found])
    times = times[np.isfinite(times)]
    return float(np.median(times)) if len(times) >= _LEAST_SECONDS else None


def weighed_until_s(measured: Sequence[MeasuredLoad], weighed: Sequence[WeighedLoad]) -> float | None:
    """Time of the last second, s, of the loads of a store that tickets are for; None for loads of logs."""
    last = {load.name.rpartition("-")[2] for load in weighed}
    return max((load.seconds[-1].time_s for load in measured if not load.log and load.name in last), default=None)


def sweeps_of(loads: Iterable[MeasuredLoad]) -> tuple[Sweep, ...]:
    """The newest whole sweeps in the loads."""
    seconds = ((load.log, row) for load in loads if not load.before_change for row in load.seconds)
    usable = ((log, row) for log, row in seconds if row.usable_for_calibration and row.sweep_id and _complete(row))
    # Ids begin anew in a store whose state was lost: a run of one id is one sweep.
    found = [[row for _, row in run] for _, run in groupby(usable, key=lambda one: (one[0], one[1].sweep_id))]
    out = []
    for rows in found[-_KEPT_SWEEPS:]:
        table = np.array(
            [(r.time_s, np.radians(r.plate_angle_deg), r.elevator_speed_rpm * RPM, r.force_n, r.force_std_dev_n) for r in rows]
        )
        if np.unique(np.round(np.degrees(table[:, 1]))).size >= 3:
            out.append(Sweep(*table.T.copy()))
    return tuple(out)


def _complete(row: SecondRow) -> bool:
    values = (row.plate_angle_deg, row.elevator_speed_rpm, row.force_n, row.force_std_dev_n)
    return all(v is not None for v in values) and float(row.force_std_dev_n or 0.0) > 0.0
