"""Inputs of recordings by channel and log: those that come on several at the same times, and those that lie in logs apart."""

from __future__ import annotations

from collections.abc import Mapping
from math import floor, isfinite

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.bulk import FrameBlock
from yieldmon.engine.sources import Sources
from yieldmon.errors import InputError
from yieldmon.utc import EARLIEST_BUS_TIME_S

_SENT_BY_ONE = ("elevator_speed", "plate_angle")
"""Quantities that no total is made of while two nodes seem to send them, as with an impact sensor's samples."""
_SHARED_S = 3
"""Seconds with frames of both channels: a logger that is started anew on another channel has one such second."""


class OneChannel:
    """Refuses a record whose impact samples come on several channels at the same times, or that has some inputs in one log and
    some in another of the same time. Speeds and angles on several are said only: a gateway's copies need do no harm."""

    def __init__(self, sources: Sources) -> None:
        inputs = (source.message for source in sources.inputs if source.quantity in _SENT_BY_ONE)
        self._impact = frozenset(source.message for source in sources.impact)
        self._watched = tuple(dict.fromkeys([*(source.message for source in sources.impact), *inputs]))
        self._seconds: dict[str, dict[str, set[int]]] = {}
        self._of_log: dict[str, set[int]] = {}
        self._said: set[str] = set()
        self._logs: list[tuple[str, dict[str, set[int]]]] = []

    def take(self, log: str, block: FrameBlock, found: Mapping[str, tuple[NDArray[np.intp], NDArray[np.float64]]]) -> None:
        """Rows and times of the messages in a block. Raises InputError at the third second that two channels share."""
        for message in self._watched:
            if message not in found:
                continue
            rows, times_s = found[message]
            by_channel = self._seconds.setdefault(message, {})
            for name, times in _by_channel(block, rows, times_s):
                seconds = _seconds_of(times)
                by_channel.setdefault(name, set()).update(seconds)
                self._of_log.setdefault(message, set()).update(seconds)
            if message in self._impact:
                _refuse_shared(log, message, by_channel)

    def take_frame(self, log: str, message: str, channel: str, time_s: float) -> None:
        """One frame of a log, as take()."""
        if message not in self._watched or not isfinite(time_s):
            return
        by_channel, second = self._seconds.setdefault(message, {}), floor(time_s)
        self._of_log.setdefault(message, set()).add(second)
        seconds = by_channel.setdefault(channel, set())
        if second not in seconds:
            seconds.add(second)
            if message in self._impact:
                _refuse_shared(log, message, by_channel)

    def end_of_log(self, log: str) -> list[str]:
        """Holds a log's inputs against those of the logs before; a line for each speed or angle on several channels.

        Times without a date say nothing of another log's.
        """
        lines = []
        for message in self._seconds.keys() - self._impact - self._said:
            if shared := _shared(message, self._seconds[message]):
                self._said.add(message)
                lines.append(f"{log}: {shared[0]}; --channel takes one")
        lines.sort()
        for by_channel in self._seconds.values():
            for name, seconds in by_channel.items():
                by_channel[name] = _dated(seconds)
        here = {message: _dated(self._of_log[message]) for message in self._watched if message in self._of_log}
        for other, there in self._logs:
            _refuse_apart(log, here, other, there)
        self._logs.append((log, here))
        self._of_log = {}
        return lines


def _seconds_of(times_s: NDArray[np.float64]) -> list[int]:
    """Whole seconds of times, which mostly rise."""
    seconds = np.floor(times_s[np.isfinite(times_s)]).astype(np.int64)
    found: list[int] = seconds[np.flatnonzero(np.diff(seconds, prepend=seconds[:1] - 1))].tolist()
    return found


def _dated(seconds: set[int]) -> set[int]:
    return {second for second in seconds if second >= EARLIEST_BUS_TIME_S}


def _refuse_apart(log: str, here: Mapping[str, set[int]], other: str, there: Mapping[str, set[int]]) -> None:
    """Read one after the other, neither would have a second with all inputs."""
    for one in (message for message in here if message not in there):
        for two in (message for message in there if message not in here):
            if len(here[one] & there[two]) >= _SHARED_S:
                problem = f"has {_of_dbc(one)} and no {_of_dbc(two)}, which {other} has at the same times"
                raise InputError(
                    log,
                    f"{problem}, as if each channel had its own logger",
                    f"both in one log: `sort -m {other} {log} > both.log`, for logs of candump",
                )


def _of_dbc(message: str) -> str:
    return message.partition("/")[0]


def _by_channel(block: FrameBlock, rows: NDArray[np.intp], times_s: NDArray[np.float64]) -> list[tuple[str, NDArray[np.float64]]]:
    channel = block.channel[rows]
    if not channel.size or (channel == channel[0]).all():
        return [(block.channels[channel[0]], times_s)] if channel.size else []
    return [(block.channels[number], times_s[channel == number]) for number in np.unique(channel).tolist()]


def _refuse_shared(log: str, message: str, by_channel: Mapping[str, set[int]]) -> None:
    if shared := _shared(message, by_channel):
        problem, one, other = shared
        expected = f"one channel: --channel {one} or {other} (bus.log_channels of the configuration)"
        raise InputError(log, f"{problem}, as on bridged buses", expected)


def _shared(message: str, by_channel: Mapping[str, set[int]]) -> tuple[str, str, str] | None:
    """What is to be said of a message on two channels, and these; None where it comes on one at a time."""
    names = sorted(by_channel.keys() - {""})
    for place, one in enumerate(names):
        for other in names[place + 1 :]:
            if len(by_channel[one] & by_channel[other]) >= _SHARED_S:
                return f"{_of_dbc(message)} comes on channels {one} and {other} at the same times", one, other
    return None
