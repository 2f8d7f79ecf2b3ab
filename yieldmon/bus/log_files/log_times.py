"""What the first times of a log say of how it was written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import can

from yieldmon.errors import InputError
from yieldmon.utc import EARLIEST_BUS_TIME_S

TIMES_LOOKED_AT = 1000
"""So many times at the beginning of a log."""
_LEAST_TIMES, _LEAST_PROGRESS = 50, 0.05
"""Fewest times that tell, and share of their way to and fro by which a clock goes on, even where frames are out of order."""
_BACKWARDS = 0.9
"""Of the steps from frame to frame, those of a log that begins with its end that go back; a damaged time is one."""


def are_between_frames(times_s: Sequence[float]) -> bool:
    """Whether the first times of a log, in its order, are each since the frame before, as of ``candump -t d``: they do not go on.

    >>> are_between_frames([0.0, 0.004, 0.001] * 20), are_between_frames([0.0, 0.004, 0.003, 0.008] * 4)
    (True, False)
    """
    if len(times_s) < _LEAST_TIMES or not 0.0 < max(times_s) < EARLIEST_BUS_TIME_S:
        return False
    way_s = sum(abs(later - earlier) for earlier, later in pairwise(times_s))
    return times_s[-1] - times_s[0] < _LEAST_PROGRESS * way_s


def run_backwards(times_s: Sequence[float]) -> bool:
    """Whether the first times of a log, in its order, begin with its end.

    >>> run_backwards([0.004 * k for k in range(100, 0, -1)]), run_backwards([0.004 * k for k in range(100)])
    (True, False)
    """
    steps = [later - earlier for earlier, later in pairwise(times_s) if later != earlier]
    return len(steps) >= _LEAST_TIMES and sum(step < 0.0 for step in steps) >= _BACKWARDS * len(steps)


def refuse_backwards(path: Path, times_s: Sequence[float]) -> None:
    """times_s: of a log's first frames. Raises InputError where they begin with its end."""
    if run_backwards(times_s):
        problem = "its times run backwards from frame to frame: the log begins with its end"
        raise InputError(str(path), problem, "frames in the order of their times, as `tac` or a sort by the time makes it")


def refuse_times_between_frames(path: Path, times_s: Sequence[float]) -> None:
    """times_s: of a candump log's first frames. Raises InputError where each is since the frame before, or they run backwards."""
    refuse_backwards(path, times_s)
    if are_between_frames(times_s):
        raise InputError(str(path), "its times are each since the frame before", "times of one clock, as `candump -L` records")


def not_backwards(messages: Iterator[can.Message], path: Path) -> Iterator[can.Message]:
    """The same frames. Raises InputError where the first of them begin with the log's end."""
    first_s: list[float] = []
    for message in messages:
        if len(first_s) < TIMES_LOOKED_AT:
            first_s.append(message.timestamp)
            if len(first_s) == TIMES_LOOKED_AT:
                refuse_backwards(path, first_s)
        yield message
    if len(first_s) < TIMES_LOOKED_AT:
        refuse_backwards(path, first_s)
