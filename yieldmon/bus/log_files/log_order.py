"""In which order several logs are one record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yieldmon.bounded import is_pipe
from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import PACKED_SUFFIX, log_format, read_log
from yieldmon.bus.log_files.text_logs import CANDUMP_SUFFIXES
from yieldmon.errors import InputError
from yieldmon.utc import EARLIEST_BUS_TIME_S

_LOOK_BYTES = 1 << 19
"""Of a candump log: some 10,000 frames."""
_LOOKS = 40
"""So often as long as no frame has a date: a recorder without a clock has none until a receiver or a network tells it."""
_LOOK_FRAMES = 2000
"""Of a format that is read frame by frame."""
_JUMP_S = 3600.0
_SETTLED_FRAMES = 100
"""From which on a clock counts as set."""
_Times = NDArray[np.float64]


def in_time_order(logs: Sequence[str]) -> list[str]:
    """Logs by the time at which each begins.

    One that begins without a date, is a pipe, or cannot be read, follows the one before it in the order given; one without a
    frame has no place in time and comes last.

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
    dated, without_date, empty = list[tuple[float, list[str]]](), list[str](), list[str]()
    before = without_date
    for log in logs:
        start_s = _start_s(log)
        if start_s is None:
            empty.append(log)
        elif np.isfinite(start_s):
            before = [log]
            dated.append((start_s, before))
        else:
            before.append(log)
    dated.sort(key=lambda item: item[0])
    return [*without_date, *(log for _, group in dated for log in group), *empty]


def _start_s(log: str) -> float | None:
    """When a log begins; nan where it does not say so, None where it holds no frame."""
    times = np.empty(0)
    try:
        if is_pipe(Path(log)):
            return float("nan")
        for block in _looks(log):
            times = np.concatenate((times, block))
            if np.any(block >= EARLIEST_BUS_TIME_S):
                break
    except (InputError, OSError):
        # What is wrong is said when it is measured.
        return float("nan")
    return _settled_s(times) if times.size else None


def _looks(log: str) -> Iterator[_Times]:
    unsaid = LogNotes(on_damage=lambda damage: None)
    if log_format(Path(log))[0] not in (*CANDUMP_SUFFIXES, PACKED_SUFFIX):
        yield np.array([message.timestamp for message in islice(read_log(log, unsaid), _LOOK_FRAMES)])
        return
    for block in islice(iter_blocks(log, unsaid, chunk_bytes=_LOOK_BYTES), _LOOKS):
        yield block.time_s


def _settled_s(times_s: _Times) -> float:
    """The first of the times since the clock was set last; nan where none is a date. A few frames of another time are errors."""
    dated = times_s[times_s >= EARLIEST_BUS_TIME_S]
    if not dated.size:
        return float("nan")
    stretches = np.split(dated, np.flatnonzero(np.abs(np.diff(dated)) > _JUMP_S) + 1)
    long = [stretch for stretch in stretches if stretch.size >= _SETTLED_FRAMES]
    return float((long[-1] if long else max(stretches, key=len))[0])
