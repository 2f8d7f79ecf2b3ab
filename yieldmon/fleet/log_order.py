"""In which order a day's logs are one record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from yieldmon.bus.logs import read_log
from yieldmon.errors import InputError
from yieldmon.utc import EARLIEST_BUS_TIME_S


def in_time_order(logs: Sequence[str]) -> list[str]:
    """Logs by the time of their first frame, where each has a date; as they are given where one has none, or cannot be read.

    Parameters
    ----------
    logs : sequence of str
        Paths.

    Returns
    -------
    list of str
    """
    if len(logs) < 2:
        return list(logs)
    starts_s = {log: _start_s(log) for log in logs}
    if any(start_s is None or start_s < EARLIEST_BUS_TIME_S for start_s in starts_s.values()):
        return list(logs)
    return sorted(logs, key=lambda log: starts_s[log] or 0.0)


def _start_s(log: str) -> float | None:
    try:
        first = next(read_log(Path(log)), None)
    except InputError:
        # What is wrong is said when it is measured.
        return None
    return None if first is None else float(first.timestamp)
