"""What a dataset says of its machines: days, mass, faults, sweeps, drift of parameters, errors of loads against tickets."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from math import sqrt
from typing import Any

import numpy as np

from yieldmon.documents.fleet import (
    DayProblem,
    FleetReportDocument,
    MachineFault,
    MachineSummary,
    ParameterDrift,
    TicketErrors,
)
from yieldmon.engine.faults import FaultCode
from yieldmon.errors import InputError
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.weighing.unlike_others import LEAST_OFF_OF_MACHINES, unlike_the_others
from yieldmon.fleet import tables
from yieldmon.fleet.names import LATEST_DATE_S, in_order, off_by_days
from yieldmon.fleet.overlaps import Overlap, overlaps
from yieldmon.fleet.querying import Query, opened
from yieldmon.fleet.repeats import Log, Repeats, logs_of, samples_of
from yieldmon.fleet.ticket_sentences import contradicting_measurement, contradicting_ticket
from yieldmon.physics.grain import GRAIN, natural_scale
from yieldmon.utc import EARLIEST_BUS_TIME_S

Rows = list[dict[str, Any]]
_TABLES = (tables.PROVENANCE, tables.FAULTS, tables.SWEEPS, tables.PARAMETERS, tables.LOADS, tables.RECORDS)

_DAYS = f"""
WITH first AS (
  SELECT machine, day, arg_min(start_s, first_number) AS start_s, list(start_s ORDER BY first_number) AS starts_s,
    list(name ORDER BY first_number) AS names FROM loads
  WHERE kind = '{tables.LOG}' GROUP BY ALL
)
SELECT machine, day, seconds, frames, total_mass_kg, crop, software_version, source_sha256, parameters_sha256, zero_known,
  logs, damages, first.start_s AS start_s, first.starts_s AS starts_s, first.names AS names
FROM provenance LEFT JOIN first USING (machine, day) ORDER BY machine, day
"""
_FAULTS = f"""
WITH last AS (SELECT machine, day, arg_max(end_s, first_number) AS end_s FROM loads WHERE kind = '{tables.LOG}' GROUP BY ALL)
SELECT machine, day, code, count(*) AS count,
  sum(least(greatest(coalesce(faults.end_s, last.end_s, begin_s) - begin_s, 0.0), provenance.seconds)) AS seconds
FROM faults LEFT JOIN last USING (machine, day) JOIN provenance USING (machine, day)
GROUP BY ALL ORDER BY machine, day, code
"""
"""A fault that the day ends with lasts to the day's end; where the clock stepped meanwhile, no longer than the day."""
_SWEEPS = "SELECT machine, state, count(*) AS count FROM sweeps GROUP BY ALL ORDER BY ALL"
_PARAMETERS = f"""
SELECT machine, name, day, arg_max(value, (coalesce(time_s, 0), version)) AS value,
  arg_max(std_dev, (coalesce(time_s, 0), version)) AS std_dev,
  any_value(value) FILTER (WHERE origin = '{ParameterOrigin.FILE}') AS configured
FROM parameters GROUP BY ALL ORDER BY machine, name, day
"""
_LOG_MASSES = f"SELECT machine, day, name, measured_kg FROM loads WHERE kind = '{tables.LOG}'"
_TICKETS = f"""
SELECT machine, day, name, measured_kg, weighed_kg, 100 * (measured_kg / weighed_kg - 1) AS error_pct FROM loads
WHERE kind = '{tables.TICKET}' AND weighed_kg > 0 ORDER BY machine, day, name
"""


def summarise(address: str) -> FleetReportDocument:
    """The summary as plain data.

    Parameters
    ----------
    address : str
        Of the dataset.

    Returns
    -------
    dict
        unfinished: whether days may be missing; totals; machines, by name; days, by machine and day; tickets; failed and
        poisoned; doubtful: damaged logs, days without a zero, clocks that contradict a day's name, machines whose days were
        measured with several parameters or releases, tickets that a machine's others contradict, logs that are there twice, and
        logs of a machine that overlap in time or hold the same samples at other times. Masses are without what is there twice;
        counted_again_kg is what that is.

    Raises
    ------
    InputError
        There is no dataset, or nothing in it.
    """
    with opened(address, _TABLES) as query:
        days = _in_order(query.rows(_DAYS))
        places = {(row["machine"], row["day"]): place for place, row in enumerate(days)}
        sweeps = query.rows(_SWEEPS)
        faults, parameters, tickets = (
            sorted(query.rows(text), key=lambda row: places[row["machine"], row["day"]])
            for text in (_FAULTS, _PARAMETERS, _TICKETS)
        )
        failed = [_problem(note, note["problem"]) for note in query.dataset.failures()]
        poisoned, unfinished = _poisoned(query), query.dataset.unfinished
        overlapping = overlaps(query, places)
        measured_kg = {(row["machine"], row["day"], row["name"]): row["measured_kg"] for row in query.rows(_LOG_MASSES)}
    doubtful, repeated = _doubtful(days, overlapping.pairs, samples_of(query), address)
    doubtful += _of_other_configurations(days) + _of_other_software(days) + _unlike_tickets(tickets)
    _leave_out(days, {**overlapping.again_kg, **{log: measured_kg.get(log) or 0.0 for log in repeated}})
    by_day: dict[tuple[str, str], dict[str, int]] = {}
    for row in faults:
        by_day.setdefault((row["machine"], row["day"]), {})[row["code"]] = row["count"]
    parts = [_by_machine(rows) for rows in (days, faults, sweeps, parameters, tickets)]
    machines = [_machine(name, *(part.get(name, []) for part in parts)) for name in parts[0]]
    return {
        "dataset": address,
        "unfinished": unfinished,
        "totals": {
            "machines": len(machines), "machine_days": len(days), "hours": sum(row["seconds"] for row in days) / 3600.0,
            "mass_kg": sum(row["mass_kg"] for row in days),
            "counted_again_kg": sum(row["counted_again_kg"] for row in days), "tickets": _errors(tickets),
            "software": sorted({_software(row) for row in days}),
            "parameter_hashes": len({row["parameters_sha256"] for row in days}),
        },
        "machines": machines,
        "days": [
            {
                "machine": row["machine"], "day": row["day"], "crop": row["crop"], "zero_known": row["zero_known"],
                "hours": row["seconds"] / 3600.0, "mass_kg": row["mass_kg"], "counted_again_kg": row["counted_again_kg"],
                "faults": by_day.get((row["machine"], row["day"]), {}),
            }
            for row in days
        ],
        "tickets": [
            {
                "machine": row["machine"], "day": row["day"], "name": row["name"], "measured_kg": row["measured_kg"],
                "weighed_kg": row["weighed_kg"], "error_pct": row["error_pct"],
            }
            for row in tickets
        ],
        "failed": failed,
        "poisoned": poisoned,
        "doubtful": doubtful,
    }  # fmt: skip


def _in_order(rows: Rows) -> Rows:
    """Days by machine and then by date, where a machine's logs hold it, else by name with numbers in it as such."""
    ordered: Rows = []
    for days in _by_machine(rows).values():
        dated = all((row["start_s"] or 0.0) > EARLIEST_BUS_TIME_S and not off_by_days(row["day"], row["start_s"]) for row in days)
        ordered += sorted(days, key=lambda row: (row["start_s"] if dated else 0.0, in_order(row["day"])))
    return ordered


def _leave_out(days: Rows, again_kg: Mapping[Log, float]) -> None:
    """Give each day the mass of what is there twice, of its logs, and its mass without that."""
    by_day: dict[tuple[str, str], float] = {}
    for (machine, day, _), mass_kg in again_kg.items():
        by_day[machine, day] = by_day.get((machine, day), 0.0) + mass_kg
    for row in days:
        row["counted_again_kg"] = by_day.get((row["machine"], row["day"]), 0.0)
        row["mass_kg"] = max(row["total_mass_kg"] - row["counted_again_kg"], 0.0)


def _doubtful(
    days: Rows, overlapping: Sequence[Overlap], samples: Mapping[Log, str], address: str
) -> tuple[list[DayProblem], list[Log]]:
    """Days whose mass may be too small, for damage or want of a zero, or that hold a log or time that is there twice; and the
    logs that are there twice as a whole."""
    from yieldmon.service.logs.recorded_before import COUNTED_TWICE

    found: list[DayProblem] = []
    repeated: list[Log] = []
    pairs = {((e.machine, e.day, e.log), (e.machine, e.other_day, e.other_log)) for e in overlapping}
    repeats = Repeats(samples, pairs)
    for row in days:
        damages, logs = _damages(row, address), logs_of(row["logs"], row["machine"], row["day"], address)
        of_day = list(repeats.of_day(row["machine"], row["day"], logs))
        repeated += [log for log, _ in of_day]
        # What these say is that the sums leave the log out.
        whole = tuple(f"{name}: " for (_, _, name), _ in of_day)
        damages = [text for text in damages if not (text.endswith(COUNTED_TWICE) and text.startswith(whole))]
        problems = [*_of_one_day(row, damages), *(problem for _, problem in of_day)]
        found += [_problem(row, problem) for problem in problems]
    for each in overlapping:
        own = repeats.digests.get((each.machine, each.day, each.log))
        other = repeats.digests.get((each.machine, each.other_day, each.other_log))
        if own is None or own != other:
            with_ = each.other_log if each.other_day == each.day else f"{each.other_day} {each.other_log}"
            same = f"{each.seconds} s with {each.mass_kg:.1f} kg"
            why = "as of a second recorder, another machine, or a clock that was set back"
            problem = f"{each.log} has {same} at times that {with_} has too, {why}; the sums leave them out"
            found.append({"machine": each.machine, "day": each.day, "problem": problem})
    return found, repeated


def _damages(row: Mapping[str, Any], address: str) -> list[str]:
    """Of a day's logs. Raises InputError where they cannot be read."""
    try:
        return [str(text) for text in json.loads(row["damages"] or "[]")]
    except (TypeError, ValueError, RecursionError) as error:
        problem = f"provenance of {row['machine']} {row['day']} is damaged"
        raise InputError(address, problem, "a dataset that `yieldmon fleet run` wrote") from error


def _of_one_day(row: Mapping[str, Any], damages: Sequence[str]) -> Iterator[str]:
    """What is wrong with a day by itself."""
    from yieldmon.service.logs.recorded_before import COUNTED_TWICE, LEFT_OUT

    yield from (text for text in damages if text.endswith((LEFT_OUT, COUNTED_TWICE)))
    if damaged := [text for text in damages if not text.endswith((LEFT_OUT, COUNTED_TWICE))]:
        more = f" (and {len(damaged) - 1} more)" if len(damaged) > 1 else ""
        yield f"damaged: {damaged[0]}{more}"
    of_logs = zip(row["names"] or (), row["starts_s"] or (), strict=True)
    if off := [(name, start_s) for name, start_s in of_logs if off_by_days(row["day"], start_s)]:
        name, start_s = off[0]
        begin = datetime.fromtimestamp(min(start_s, LATEST_DATE_S), UTC).date().isoformat()
        more = f" (and {len(off) - 1} more off)" if len(off) > 1 else ""
        yield f"{name} begins on {begin} by its clock{more}"
    if row["seconds"] and not row["zero_known"]:
        yield f"no zero of the sensor is known, so none of the {row['seconds']} s has a flow"


def _by_machine(rows: Iterable[dict[str, Any]]) -> dict[str, Rows]:
    found: dict[str, Rows] = {}
    for row in rows:
        found.setdefault(row["machine"], []).append(row)
    return found


def _machine(name: str, days: Rows, faults: Rows, sweeps: Rows, parameters: Rows, tickets: Rows) -> MachineSummary:
    codes: dict[str, MachineFault] = {}
    for row in faults:
        sums = codes.setdefault(row["code"], {"count": 0, "days": 0, "seconds": 0.0})
        sums["count"] += row["count"]
        sums["days"] += 1
        sums["seconds"] += row["seconds"]
    disagrees = FaultCode.MODEL_DISAGREES.value
    return {
        "machine": name,
        "days": len(days),
        "first_day": days[0]["day"],
        "last_day": days[-1]["day"],
        "crops": sorted({row["crop"] for row in days if row["crop"]}),
        "hours": sum(row["seconds"] for row in days) / 3600.0,
        "mass_kg": sum(row["mass_kg"] for row in days),
        "counted_again_kg": sum(row["counted_again_kg"] for row in days),
        "days_without_zero": [row["day"] for row in days if not row["zero_known"]],
        "faults": codes,
        "model_disagrees": [row["day"] for row in faults if row["code"] == disagrees],
        "sweeps": {row["state"]: row["count"] for row in sweeps},
        "parameters": _drift(parameters),
        "tickets": _errors(tickets),
    }


def _drift(rows: Rows) -> dict[str, ParameterDrift]:
    """First and last value of each parameter at the end of a day, its change, and its value by day. What days began with that
    somebody changed has not drifted."""
    found: dict[str, Rows] = {}
    for row in rows:
        found.setdefault(row["name"], []).append(row)
    return {
        name: {
            "first": values[0]["value"],
            "by_day": {row["day"]: row["value"] for row in values},
            "last": values[-1]["value"],
            "std_dev": values[-1]["std_dev"],
            "change_pct": _change_pct(name, values),
        }
        for name, values in found.items()
    }


def _change_pct(name: str, values: Rows) -> float | None:
    """Change of a grain parameter relative to what the force follows; None for an effect's size, which is near 0 or of either
    sign, and where not all days began with the same value."""
    if name not in GRAIN or len({row["configured"] for row in values if row["configured"] is not None}) > 1:
        return None
    first, last = float(values[0]["value"]), float(values[-1]["value"])
    return 100.0 * (last - first) / natural_scale(GRAIN[name], first)


def _of_other_configurations(days: Rows) -> list[DayProblem]:
    """Machines whose days were measured with several configurations or parameters, as after an interrupted run with others."""
    found: list[DayProblem] = []
    for rows in _by_machine(days).values():
        others = [row for row in rows if row["parameters_sha256"] != rows[0]["parameters_sha256"]]
        if others:
            more = f" (and {len(others) - 1} more)" if len(others) > 1 else ""
            problem = f"this day{more} was measured with other parameters or settings than {rows[0]['day']}"
            found.append(_problem(others[0], f"{problem}; `fleet run` of all its logs measures them alike"))
    return found


def _of_other_software(days: Rows) -> list[DayProblem]:
    """Machines whose days were measured by several releases, as where the source no longer has the logs of some."""
    found: list[DayProblem] = []
    for rows in _by_machine(days).values():
        others = [row for row in rows if _software(row) != _software(rows[0])]
        if others:
            more = f" (and {len(others) - 1} more)" if len(others) > 1 else ""
            first = f"{rows[0]['day']} by {_software(rows[0])}"
            problem = f"this day{more} was measured by yieldmon {_software(others[0])}, {first}"
            found.append(_problem(others[0], f"{problem}; `fleet run` of all its logs measures them alike"))
    return found


def _software(day: Mapping[str, Any]) -> str:
    """The release that measured a day, with the beginning of its source's hash."""
    return f"{day['software_version']} ({day['source_sha256'][:12]})"


def _errors(rows: Rows) -> TicketErrors:
    """Errors of measured against weighed loads, %; None without tickets."""
    errors = [row["error_pct"] for row in rows]
    if not errors:
        return {"count": 0, "mean_error_pct": None, "rms_error_pct": None, "worst_error_pct": None}
    return {
        "count": len(errors),
        "mean_error_pct": sum(errors) / len(errors),
        "rms_error_pct": sqrt(sum(error * error for error in errors) / len(errors)),
        "worst_error_pct": max(errors, key=abs),
    }


def _unlike_tickets(tickets: Rows) -> list[DayProblem]:
    """Tickets that none of the machine's others bears out, those of loads of which nothing was measured, and machines with all
    tickets far from what was measured."""
    found: list[DayProblem] = []
    for rows in _by_machine(tickets).values():
        ratios = np.array([row["measured_kg"] / row["weighed_kg"] for row in rows])
        with np.errstate(divide="ignore"):
            unlike = unlike_the_others(np.log(ratios)) | (ratios <= 0.0)
        usual = float(np.median(ratios[~unlike])) if not unlike.all() else 1.0
        off = -float(np.log(usual))
        if abs(off) > LEAST_OFF_OF_MACHINES:
            found.append(_problem(rows[0], contradicting_measurement(off)))
        for row, ratio in zip(itertools.compress(rows, unlike), ratios[unlike], strict=True):
            weighed_kg = row["weighed_kg"]
            nothing = f"weighs {weighed_kg:.0f} kg, and nothing was measured"
            said = contradicting_ticket(weighed_kg, usual / ratio) if ratio > 0 else nothing
            found.append(_problem(row, f"the ticket of {row['name']} {said}"))
    return found


def _poisoned(query: Query) -> list[DayProblem]:
    return [
        {"machine": commit.machine, "day": commit.day, "where": item["where"], "problem": item["problem"]}
        for commit in query.commits
        for item in commit.content["poisoned"]
    ]


def _problem(of: Mapping[str, Any], problem: str) -> DayProblem:
    """of: a row of the machine's day."""
    return {"machine": of["machine"], "day": of["day"], "problem": problem}
