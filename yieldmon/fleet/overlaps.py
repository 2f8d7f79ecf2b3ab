"""Logs of one machine that hold the same time, and so count its mass twice: one beside its packed or converted form, or two
recorders' logs that overlap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.fleet import tables
from yieldmon.fleet.querying import Query
from yieldmon.utc import EARLIEST_BUS_TIME_S

_LOGS = f"""
SELECT machine, day, name, first_number, last_number, least(start_s, end_s) AS from_s, greatest(start_s, end_s) AS to_s FROM loads
WHERE kind = '{tables.LOG}' AND seconds > 0 AND least(start_s, end_s) > {EARLIEST_BUS_TIME_S} ORDER BY machine, day, first_number
"""
_COLUMNS = ("number", "time_s", "duration_s", "mass_kg")
_SECONDS = f"SELECT {', '.join(_COLUMNS)} FROM {{}}"


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


@dataclass(frozen=True, slots=True)
class Overlaps:
    """pairs: by machine, and by day and place of the earlier log. again_kg: by machine, day and name of a log, its mass of
    seconds at times that logs before it have too, each second once."""

    pairs: tuple[Overlap, ...]
    again_kg: Mapping[tuple[str, str, str], float]


def overlaps(query: Query, order: Mapping[tuple[str, str], int] | None = None) -> Overlaps:
    """The pairs of logs in which grain of the same time is counted in both.

    Parameters
    ----------
    query : Query
        Over the loads and the records. Records are read of logs only whose first and last times overlap.
    order : dict
        Place of each machine's day among the others; None: by name.

    Returns
    -------
    Overlaps
    """
    by_machine: dict[str, list[dict[str, Any]]] = {}
    for row in query.rows(_LOGS):
        by_machine.setdefault(row["machine"], []).append(row)
    found, again_kg = list[Overlap](), dict[tuple[str, str, str], float]()
    for logs in by_machine.values():
        if order is not None:
            logs.sort(key=lambda log: order[log["machine"], log["day"]])
        days = _Days(query)
        meeting = _meeting(logs)
        last = {logs[place]["day"]: (first, second) for first, second in meeting for place in (first, second)}
        seconds_again: dict[int, NDArray[np.bool_]] = {}
        last_before = {second: first for first, second in meeting}
        for first, second in meeting:
            ours, theirs = (days.seconds(logs[place]) for place in (first, second))
            again = within(theirs, ours)
            mass_kg = float(theirs[again, 2].sum())
            log, other = logs[second], logs[first]
            if mass_kg > 0.0 and ours[within(ours, theirs), 2].sum() > 0.0:
                where = log["machine"], log["day"], log["name"], other["day"], other["name"]
                found.append(Overlap(*where, int(again.sum()), mass_kg))
                seconds_again[second] = again | seconds_again.get(second, np.False_)
            if last_before[second] == first and second in seconds_again:
                again_kg[log["machine"], log["day"], log["name"]] = float(theirs[seconds_again.pop(second), 2].sum())
            for day in {logs[first]["day"], logs[second]["day"]}:
                if last[day] == (first, second):
                    days.forget(day)
    return Overlaps(tuple(found), again_kg)


def _meeting(logs: Sequence[dict[str, Any]]) -> list[tuple[int, int]]:
    """The pairs of logs, by place, whose first and last times overlap, in the logs' order."""
    found, under_way = [], list[int]()
    for i in sorted(range(len(logs)), key=lambda i: float(logs[i]["from_s"])):
        under_way = [k for k in under_way if logs[k]["to_s"] > logs[i]["from_s"]]
        found += [(min(i, k), max(i, k)) for k in under_way if logs[i]["to_s"] > logs[i]["from_s"]]
        under_way.append(i)
    return sorted(found)


class _Days:
    """The seconds of a machine's days, each day read once."""

    def __init__(self, query: Query) -> None:
        self._query = query
        self._read: dict[str, NDArray[np.float64]] = {}
        self._of_logs: dict[tuple[str, int], NDArray[np.float64]] = {}

    def seconds(self, log: dict[str, Any]) -> NDArray[np.float64]:
        """End, duration and mass of a log's seconds in the order of their ends, shape (n, 3)."""
        day, first, last = log["day"], log["first_number"], log["last_number"]
        if (day, first) not in self._of_logs:
            if day not in self._read:
                self._read[day] = _by_number(self._query, log["machine"], day)
            numbers = self._read[day][:, 0]
            found = self._read[day][np.searchsorted(numbers, first) : np.searchsorted(numbers, last, side="right"), 1:]
            self._of_logs[day, first] = _in_order(found)
        return self._of_logs[day, first]

    def forget(self, day: str) -> None:
        """A day that is not asked for any more."""
        self._read.pop(day, None)
        for key in [key for key in self._of_logs if key[0] == day]:
            del self._of_logs[key]


def _by_number(query: Query, machine: str, day: str) -> NDArray[np.float64]:
    """Number, end, duration and mass of a day's seconds, shape (n, 4)."""
    columns = query.columns(_SECONDS.format(query.of_partition("records", machine, day)))
    return _in_order(np.stack([columns[name].astype(np.float64) for name in _COLUMNS], axis=-1))


def _in_order(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """By the first column."""
    order = rows[:, 0]
    return rows if np.all(order[1:] >= order[:-1]) else rows[np.argsort(order, kind="stable")]


def within(those: NDArray[np.float64], these: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of those seconds have their middle in one of these.

    Parameters
    ----------
    those, these : ndarray, shape (n, m), (k, m)
        End and duration of each second, s, and what else; these in the order of their ends.

    Returns
    -------
    ndarray, shape (n,)
    """
    middles = those[:, 0] - 0.5 * those[:, 1]
    at = np.searchsorted(these[:, 0], middles)
    begins = np.append(these[:, 0] - these[:, 1], np.inf)
    inside: NDArray[np.bool_] = middles > begins[at]
    return inside
