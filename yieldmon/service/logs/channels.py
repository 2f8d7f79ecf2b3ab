"""Inputs that come on several channels of a recording at the same times, as those of bridged buses do."""

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
    """Refuses a record whose impact samples, speed or angle come on several channels at the same times."""

    def __init__(self, sources: Sources) -> None:
        inputs = (source.message for source in sources.inputs if source.quantity in _SENT_BY_ONE)
        self._watched = tuple(dict.fromkeys([*(source.message for source in sources.impact), *inputs]))
        self._seconds: dict[str, dict[str, set[int]]] = {}

    def take(self, log: str, block: FrameBlock, found: Mapping[str, tuple[NDArray[np.intp], NDArray[np.float64]]]) -> None:
        """Rows and times of the messages in a block. Raises InputError at the third second that two channels share."""
        for message in self._watched:
            if message not in found:
                continue
            rows, times_s = found[message]
            by_channel = self._seconds.setdefault(message, {})
            for name, times in _by_channel(block, rows, times_s):
                seconds = by_channel.setdefault(name, set())
                seconds.update(np.unique(np.floor(times[np.isfinite(times)])).astype(np.int64).tolist())
            if len(by_channel) > 1:
                _refuse_shared(log, message, by_channel)

    def take_frame(self, log: str, message: str, channel: str, time_s: float) -> None:
        """One frame of a log, as take()."""
        if message in self._watched and isfinite(time_s):
            by_channel = self._seconds.setdefault(message, {})
            by_channel.setdefault(channel, set()).add(floor(time_s))
            if len(by_channel) > 1:
                _refuse_shared(log, message, by_channel)

    def end_of_log(self) -> None:
        """Times without a date say nothing of another log's."""
        for by_channel in self._seconds.values():
            for name, seconds in by_channel.items():
                by_channel[name] = {second for second in seconds if second >= EARLIEST_BUS_TIME_S}


def _by_channel(block: FrameBlock, rows: NDArray[np.intp], times_s: NDArray[np.float64]) -> list[tuple[str, NDArray[np.float64]]]:
    channel = block.channel[rows]
    if not channel.size or (channel == channel[0]).all():
        return [(block.channels[channel[0]], times_s)] if channel.size else []
    return [(block.channels[number], times_s[channel == number]) for number in np.unique(channel).tolist()]


def _refuse_shared(log: str, message: str, by_channel: Mapping[str, set[int]]) -> None:
    names = sorted(by_channel.keys() - {""})
    for place, one in enumerate(names):
        for other in names[place + 1 :]:
            if len(by_channel[one] & by_channel[other]) >= _SHARED_S:
                of_dbc = message.partition("/")[0]
                raise InputError(
                    log,
                    f"{of_dbc} comes on channels {one} and {other} at the same times, as of bridged buses or two loggers",
                    f"one channel: --channel {one} or {other} (bus.log_channels of the configuration)",
                )
