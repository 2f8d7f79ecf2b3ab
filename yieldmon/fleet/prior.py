"""The prior of a crop from a dataset's tickets."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from yieldmon.errors import InputError
from yieldmon.estimation.parameters import METHOD, POOLED, ParameterSet
from yieldmon.estimation.weighing.fleet_prior import LEAST_MACHINES, FleetPrior, MachineLoads, load_errors, pooled
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.estimation.weighing.unlike_others import unlike_the_other_densities, unlike_the_other_machines, unlike_the_others
from yieldmon.files import machine_file
from yieldmon.files.crops import crop
from yieldmon.files.ticket_file import WeighedTicket
from yieldmon.fleet import tables
from yieldmon.fleet.querying import Query, opened
from yieldmon.fleet.repeats import contents_of
from yieldmon.fleet.ticket_sentences import contradicting_density, contradicting_machine, contradicting_ticket
from yieldmon.fleet.usable_seconds import Seen
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.service.logs import weighed_loads
from yieldmon.service.logs.measured_loads import MeasuredLoad
from yieldmon.service.storage.rows import SecondRow
from yieldmon.units import counted

_DAYS = "SELECT machine, day, machine_document FROM provenance WHERE lower(crop) = lower(?) ORDER BY machine, day"
_OF_TICKETS = f"FROM loads JOIN provenance USING (machine, day) WHERE kind = '{tables.TICKET}'"
_OF_NO_CROP = f"SELECT count(*) AS count {_OF_TICKETS} AND coalesce(crop, '') = ''"
_CROPS = f"SELECT DISTINCT crop {_OF_TICKETS} AND crop != '' ORDER BY crop"
_TICKETS = f"SELECT * FROM loads WHERE kind = '{tables.TICKET}' AND machine = ? AND day = ? ORDER BY first_number"
_LOGS = f"SELECT name, first_number, last_number FROM loads WHERE kind = '{tables.LOG}' AND machine = ? AND day = ? ORDER BY 2"
_RECORDS = "SELECT * FROM {} WHERE number BETWEEN ? AND ? ORDER BY number"
_VERSIONS = "SELECT version, name, value FROM parameters WHERE machine = ? AND day = ? ORDER BY version, name"


@dataclass(frozen=True)
class CropPrior:
    """A crop's prior, and from what: machines with their loads; left_out: tickets that could not be used, with the reason."""

    prior: FleetPrior
    machines: tuple[MachineLoads, ...]
    left_out: tuple[str, ...]


def crop_prior(address: str, name: str) -> CropPrior:
    """The prior of a crop.

    Parameters
    ----------
    address : str
        Of the dataset.
    name : str
        A shipped crop; days of this crop are used.

    Returns
    -------
    CropPrior

    Raises
    ------
    InputError
        The crop is not shipped, or too few machines have tickets for it.
    """
    name = crop(name).name
    start = crop(name).parameters()
    with opened(address) as query:
        machines, left_out = _machines(query, name, start)
        of_no_crop = query.rows(_OF_NO_CROP)[0]["count"]
        crops = [row["crop"] for row in query.rows(_CROPS)]
    found = None
    while found is None and len(machines) >= LEAST_MACHINES:
        try:
            found = pooled(start, machines)
        except ValueError as error:
            raise InputError(address, str(error)) from error
        densities = found.machines[:, 0]
        unlike = unlike_the_other_densities(densities)
        if unlike is not None:
            off = densities[unlike] - float(np.median(np.delete(densities, unlike)))
            left_out.append(contradicting_density(machines.pop(unlike).name, off))
            found = None
    if found is None:
        without = f"; {counted(of_no_crop, 'ticket')} of days without a crop" if of_no_crop else ""
        mend = ", or `fleet run --crop`, for days without one" if of_no_crop else ""
        others = f"; its tickets are for {', '.join(crops)}" if crops and name not in crops else ""
        found_no = f"has tickets of {counted(len(machines), 'machine')} for {name}{others}{without}{_others(left_out)}"
        raise InputError(address, found_no, f"at least {LEAST_MACHINES}{mend}")
    facts = {
        "crop": name, METHOD: POOLED, "machines": str(len(machines)),
        "loads": str(sum(len(machine.loads) for machine in machines)), "start": f"config/crops.yaml: {name}",
    }  # fmt: skip
    return CropPrior(
        replace(found, parameter_set=replace(found.parameter_set, provenance=facts)), tuple(machines), tuple(left_out)
    )


def _others(left_out: Sequence[str]) -> str:
    if not left_out:
        return ""
    more = f" (and {len(left_out) - 1} more)" if len(left_out) > 1 else ""
    return f" that can be used; left out: {left_out[0]}{more}"


def _machines(query: Query, name: str, start: ParameterSet) -> tuple[list[MachineLoads], list[str]]:
    loads: dict[str, list[tuple[str, WeighedLoad]]] = {}
    models: dict[str, ForwardModel] = {}
    left_out = []
    contents = contents_of(query)
    seen: dict[_Covered, list[tuple[float, str]]] = {}
    for day in query.rows(_DAYS, (name,)):
        machine = machine_file.from_document(json.loads(day["machine_document"]), f"{day['machine']} {day['day']}")
        if day["machine"] in models and models[day["machine"]].machine != machine:
            left_out.append(f"{day['machine']} {day['day']}: another geometry than on days before")
            continue
        models[day["machine"]] = ForwardModel(machine, start.effects)
        where = day["machine"], day["day"]
        logs = [(contents.get((*where, log["name"]), ""), log) for log in query.rows(_LOGS, where)]
        for ticket in query.rows(_TICKETS, where):
            here = f"{where[0]} {where[1]}: {ticket['name']}"
            before, weighed_kg = seen.setdefault(_what_it_covers(ticket, logs), []), float(ticket["weighed_kg"])
            if first := next((name for kg, name in before if abs(kg - weighed_kg) <= _ROUNDED * weighed_kg), ""):
                left_out.append(f"{here} repeats {first}, with the same logs and weight")
                continue
            before.append((weighed_kg, here))
            try:
                found = _weighed(query, day, ticket, [log for _, log in logs], machine)
            except InputError as error:
                left_out.append(str(error))
            else:
                loads.setdefault(day["machine"], []).append((here, found))
    machines = []
    for of, weighed in loads.items():
        kept, unlike = _alike(models[of], start, weighed)
        machines.append(MachineLoads(of, models[of], tuple(kept)))
        left_out += unlike
    alike, unlike = _alike_machines(machines, start)
    return alike, [*left_out, *unlike]


def _alike_machines(machines: Sequence[MachineLoads], start: ParameterSet) -> tuple[list[MachineLoads], list[str]]:
    """The machines without those that none of the others bears out, and lines on these."""
    errors = np.array([np.median(load_errors(of.model, start, of.loads)) for of in machines])
    unlike = unlike_the_other_machines(errors)
    usual = float(np.median(errors[~unlike])) if unlike.any() else 0.0
    lines = [
        contradicting_machine(of.name, usual - error) for of, error, one in zip(machines, errors, unlike, strict=True) if one
    ]
    return [of for of, one in zip(machines, unlike, strict=True) if not one], lines


def _alike(
    model: ForwardModel, start: ParameterSet, weighed: Sequence[tuple[str, WeighedLoad]]
) -> tuple[list[WeighedLoad], list[str]]:
    """The loads of one machine without those that none of its others bears out, and lines on these."""
    loads = [load for _, load in weighed]
    errors = load_errors(model, start, loads)
    unlike = unlike_the_others(errors)
    usual = float(np.exp(np.median(errors[~unlike]))) if unlike.any() else 1.0
    lines = [
        f"{here} {contradicting_ticket(load.weighed_kg, usual / np.exp(error))}"
        for (here, load), error, one in zip(weighed, errors, unlike, strict=True)
        if one
    ]
    return [load for load, one in zip(loads, unlike, strict=True) if not one], lines


_Covered = tuple[tuple[str, ...], int, int]
"""What the logs of a ticket hold, and its first and last second in the first and last of them."""
_ROUNDED = 0.001
"""Within which two weights are one, as it was rounded in kilograms, hundredths of a tonne and pounds."""


def _what_it_covers(ticket: dict[str, Any], logs: Sequence[tuple[str, dict[str, Any]]]) -> _Covered:
    first, last = ticket["first_number"], ticket["last_number"]
    covered = [(content, log) for content, log in logs if _covers(ticket, log)]
    names = tuple(content or str(log) for content, log in covered)
    if not covered:
        return (str(ticket),), first, last
    return names, first - covered[0][1]["first_number"], last - covered[-1][1]["first_number"]


def _covers(ticket: dict[str, Any], log: dict[str, Any]) -> bool:
    """Whether a log is one of those that a ticket speaks of: by name, since others may lie between them in time; of a day that
    an earlier release measured, where names are not noted, by its seconds."""
    if ticket.get("logs") is not None:
        return log["name"] in json.loads(ticket["logs"])
    return bool(log["first_number"] <= ticket["last_number"] and ticket["first_number"] <= log["last_number"])


def _weighed(
    query: Query, day: dict[str, Any], ticket: dict[str, Any], logs: Sequence[dict[str, Any]], machine: Machine
) -> WeighedLoad:
    where = (day["machine"], day["day"])
    found = query.rows(_RECORDS.format(query.of_partition("records", *where)), (ticket["first_number"], ticket["last_number"]))
    rows, seen, kept = [SecondRow(**row) for row in found], Seen(), list[SecondRow]()
    for log in (log for log in logs if _covers(ticket, log)):
        # Two recorders' logs, or a log and its converted form, hold what was weighed once.
        kept += seen.new([row for row in rows if log["first_number"] <= row.number <= log["last_number"]])
    measured = MeasuredLoad(ticket["name"], "", tuple(row for row in kept if row.mass_kg > 0.0), dict(_versions(query, where)))
    paper = WeighedTicket(
        first=ticket["name"],
        last=ticket["name"],
        mass_kg=ticket["weighed_kg"],
        std_dev_kg=ticket["weighed_std_dev_kg"],
        where=f"{where[0]} {where[1]}",
        # Of a day that an earlier release measured it is not noted.
        other_std_dev_kg=ticket.get("other_monitor_std_dev_kg") or 0.0,
    )
    return weighed_loads.match([measured], [paper], machine)[0]


def _versions(query: Query, where: tuple[str, str]) -> Iterator[tuple[int, ParameterSet]]:
    values: dict[int, dict[str, float]] = {}
    for row in query.rows(_VERSIONS, where):
        values.setdefault(row["version"], {})[row["name"]] = row["value"]
    for version, found in values.items():
        yield version, ParameterSet(found, version=version)
