"""The seconds of a machine's sweeps, each time once, although logs may hold it twice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yieldmon.fleet import tables
from yieldmon.fleet.overlaps import within
from yieldmon.fleet.querying import Query
from yieldmon.fleet.repeats import Log, repeated_logs
from yieldmon.service.storage.rows import SecondRow
from yieldmon.utc import EARLIEST_BUS_TIME_S

_LOGS = f"SELECT machine, day, name, first_number, last_number FROM loads WHERE kind = '{tables.LOG}' ORDER BY ALL"
_SECONDS = "SELECT * FROM {} WHERE usable_for_calibration = 1 ORDER BY number"


@dataclass
class Seen:
    """Times of a machine's seconds so far: end and duration, s, in the order of their ends."""

    times: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))

    def new(self, rows: list[SecondRow]) -> list[SecondRow]:
        """Those of one log's rows that are not in a log before, which join what is seen. Times that count from a recorder's start
        are no dates, so they are never there before."""
        dated = [row for row in rows if row.time_s > EARLIEST_BUS_TIME_S]
        if not dated:
            return rows
        own = np.array([(row.time_s, row.duration_s) for row in dated])
        again = {id(row) for row, there in zip(dated, within(own, self.times), strict=True) if there}
        every = np.concatenate((self.times, own))
        self.times = every[np.argsort(every[:, 0], kind="stable")]
        return [row for row in rows if id(row) not in again]


def usable_seconds(query: Query) -> Iterator[tuple[str, tuple[SecondRow, ...]]]:
    """Machine and the seconds of one of its days that count for sweeps, day by day.

    Parameters
    ----------
    query : Query
        Over the loads, the provenance and the records.

    Yields
    ------
    tuple of str and tuple of SecondRow
        Without those of a log that holds what another of the dataset holds, and those at times that an earlier log of the
        machine has too, by day and place: a sweep that two logs hold is one sweep.
    """
    repeated = repeated_logs(query)
    logs: dict[tuple[str, str], list[tuple[Log, int, int]]] = {}
    for row in query.rows(_LOGS):
        log = row["machine"], row["day"], row["name"]
        logs.setdefault(log[:2], []).append((log, row["first_number"], row["last_number"]))
    seen: dict[str, Seen] = {}
    for commit in query.commits:
        where = commit.machine, commit.day
        rows = [SecondRow(**row) for row in query.rows(_SECONDS.format(query.of_partition("records", *where)))]
        of_logs = logs.get(where, [])
        machine, kept = seen.setdefault(commit.machine, Seen()), list[SecondRow]()
        for log, first, last in of_logs:
            if log not in repeated:
                kept += machine.new([row for row in rows if first <= row.number <= last])
        if not of_logs:
            kept = machine.new(rows)
        if kept:
            yield commit.machine, tuple(sorted(kept, key=lambda row: row.number))
