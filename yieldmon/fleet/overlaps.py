"""Logs of one machine that hold the same time, and so count its mass twice: one beside its packed or converted form, or two
recorders' logs that overlap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.fleet import tables
from yieldmon.fleet.querying import Query

_LOGS = f"""
SELECT machine, day, name, first_number, last_number, least(start_s, end_s) AS from_s, greatest(start_s, end_s) AS to_s FROM loads
WHERE kind = '{tables.LOG}' AND seconds > 0 AND start_s IS NOT NULL AND end_s IS NOT NULL ORDER BY machine, day, first_number
"""
_SECONDS = "SELECT time_s, duration_s, mass_kg FROM {} WHERE number BETWEEN ? AND ? ORDER BY number"


@dataclass(frozen=True, slots=True)
class Overlap:
    """Seconds of a log at times that an earlier one of the machine, by day and place, has too, and their mass, kg."""

    machine: str
    day: str
    log: str
    other_day: str
    other_log: str
    seconds: int
    mass_kg: float


def overlaps(query: Query) -> list[Overlap]:
    """The pairs of logs in which grain of the same time is counted in both.

    Parameters
    ----------
    query : Query
        Over the loads and the records. Records are read of logs only whose first and last times overlap.

    Returns
    -------
    list of Overlap
        By machine, and by day and place of the earlier log.
    """
    by_machine: dict[str, list[dict[str, Any]]] = {}
    for row in query.rows(_LOGS):
        by_machine.setdefault(row["machine"], []).append(row)
    found = []
    for logs in by_machine.values():
        seconds: dict[tuple[str, int], NDArray[np.float64]] = {}
        for first, second in _meeting(logs):
            for log in (first, second):
                if (log["day"], log["first_number"]) not in seconds:
                    seconds[log["day"], log["first_number"]] = _seconds(query, log)
            ours, theirs = (seconds[log["day"], log["first_number"]] for log in (first, second))
            again = _within(theirs, ours)
            mass_kg = float(theirs[again, 2].sum())
            if mass_kg > 0.0 and ours[_within(ours, theirs), 2].sum() > 0.0:
                where = second["machine"], second["day"], second["name"], first["day"], first["name"]
                found.append(Overlap(*where, int(again.sum()), mass_kg))
    return found


def _meeting(logs: Sequence[dict[str, Any]]) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """The pairs of logs whose first and last times overlap, in the logs' order."""
    found, under_way = [], list[int]()
    for i in sorted(range(len(logs)), key=lambda i: float(logs[i]["from_s"])):
        under_way = [k for k in under_way if logs[k]["to_s"] > logs[i]["from_s"]]
        found += [(min(i, k), max(i, k)) for k in under_way if logs[i]["to_s"] > logs[i]["from_s"]]
        under_way.append(i)
    for first, second in sorted(found):
        yield logs[first], logs[second]


def _seconds(query: Query, log: dict[str, Any]) -> NDArray[np.float64]:
    """End, duration and mass of a log's seconds in the order of their ends, shape (n, 3)."""
    records = query.of_partition("records", log["machine"], log["day"])
    rows = query.rows(_SECONDS.format(records), (log["first_number"], log["last_number"]))
    found = np.array([(row["time_s"], row["duration_s"], row["mass_kg"]) for row in rows], np.float64).reshape(-1, 3)
    return found[np.argsort(found[:, 0], kind="stable")]


def _within(those: NDArray[np.float64], these: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of those seconds have their middle in one of these, shape (n,)."""
    middles = those[:, 0] - 0.5 * those[:, 1]
    at = np.searchsorted(these[:, 0], middles)
    begins = np.append(these[:, 0] - these[:, 1], np.inf)
    inside: NDArray[np.bool_] = middles > begins[at]
    return inside
