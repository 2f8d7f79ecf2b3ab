"""Frames of a log that one before it holds: two loggers recorded one bus under one channel name, and its grain counts once.

The samples of an impact sensor hold noise: the same bytes come again at the same times only in a recording of the same bus. Where
they come at other times, one of the two clocks is wrong: which one cannot be told, so both are measured, and named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from yieldmon import utc
from yieldmon.bounded import is_pipe
from yieldmon.bus.bulk import FrameBlock, block_of
from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.errors import InputError

LEFT_OUT = "left out, as the grain counts once"
"""End of the line that says so."""
COUNTED_TWICE = "both are measured: leave one out, or correct its times"
"""End of the line about frames at other times."""
_MULTIPLIER, _ALL_BUT_BITS = np.uint64(0x9E3779B97F4A7C15), np.uint64(58)
"""Of a payload, so that one in 64 of them is compared, whatever its counter."""
_LEAST_ALIKE = 8
"""Of the frames compared, at as constant a distance in time."""
_CLOCKS_S, _JITTER_S = 60.0, 0.05
"""How far the clocks of two loggers may be apart, and how unsteadily they may stamp a frame."""
_LOOK_BYTES, _LOOKS, _ENOUGH = 1 << 19, 40, 64
"""What is read of a log's beginning at a time, how often at most, and frames compared after which it is another record."""

_ONE_IN, _KEPT_BIT = 4, 32
"""Of the frames compared, so many are kept for the search at any distance in time."""
_DRIFT = 5e-4
"""Of two clocks against each other."""
_LEAST_MIXED, _LEAST_VALUES = 3, 4
"""Bytes of the frames in which there are so many values: a counter beside samples that do not change has fewer, and comes again
without being the same."""

LEAST_SHARED_S = 3
"""Seconds with frames of two logs: one that follows another shares the second in which that ended."""

_Key = tuple[str, int, int]
"""Channel, identifier with flags, payload."""


@dataclass(frozen=True, slots=True)
class SameTimes:
    """Another log, and how many seconds of it are those of a log too."""

    log: str
    seconds: int


@dataclass
class _Log:
    """Times of the frames that are compared by what they hold; None where the same came twice. seconds: that have frames."""

    path: str
    times_s: dict[_Key, float | None] = field(default_factory=dict)
    seconds: set[int] = field(default_factory=set)
    last_s: float = float("-inf")

    def take(self, keys: list[_Key], times_s: list[float]) -> None:
        """More of its frames."""
        for key, time_s in zip(keys, times_s, strict=True):
            self.times_s[key] = None if key in self.times_s else time_s


class RecordedBefore:
    """The impact sensor's frames of logs that are read one after the other.

    Attributes
    ----------
    again_until_s : float
        Time until which the frames of the log under way are those of one before, -inf where none is.
    """

    def __init__(self, channels: tuple[str, ...] = ()) -> None:
        """channels: whose frames are taken; empty: all."""
        self._channels = channels
        self._logs: list[_Log] = []
        self._identifiers: set[int] = set()
        self.again_until_s = float("-inf")
        self._known: dict[tuple[int, int], tuple[str, float]] = {}
        """Log and time of frames of all logs before, by identifier and payload."""

    def begin(self, path: str, part: int = 0) -> str:
        """The next log: a line that says until when its frames are those of one before, "" where none is. part: its number from 0
        in a file of packed logs."""
        until_s, line = float("-inf"), ""
        beginning = self._beginning(path, part) if self._logs else _Log(path)
        path = f"{path}, log {part + 1}" if part else path
        for other in self._logs:
            found = _apart_s(beginning, other)
            if found is not None and other.last_s + sum(found) > until_s:
                apart_s, unsteady_s = found
                until_s = other.last_s + apart_s + unsteady_s
                held = (
                    f"up to {utc.text(utc.moment(until_s))} it holds the frames of {other.path} again ({1e3 * apart_s:+.0f} ms)"
                )
                line = f"{path}: {held}; {LEFT_OUT}"
        self._logs.append(_Log(path))
        self.again_until_s = until_s
        return line

    def take(self, block: FrameBlock, rows: NDArray[np.intp]) -> None:
        """Rows of the sensor's frames in a block of the log."""
        self._identifiers.update(_without_repeats(block.can_id[rows]).tolist())
        if not rows.size:
            return
        log, times_s = self._logs[-1], block.time_s[rows]
        log.last_s = max(log.last_s, float(times_s.max()))
        # Without a date all logs begin at the same second.
        dated = times_s[times_s >= utc.EARLIEST_BUS_TIME_S]
        log.seconds.update(_without_repeats(np.floor(dated)).astype(np.int64).tolist())
        log.take(*_compared(block, rows))

    def same_times(self) -> tuple[SameTimes, ...]:
        """The logs before that have frames of the sensor at times at which the last one has others."""
        log = self._logs[-1]
        shared = ((other.path, len(log.seconds & other.seconds)) for other in self._logs[:-1])
        return tuple(SameTimes(path, seconds) for path, seconds in shared if seconds >= LEAST_SHARED_S)

    def at_other_times(self) -> list[str]:
        """Once the last log is read: a line for each log before that has its frames of the sensor at times further off than two
        loggers' clocks are."""
        log = self._logs[-1]
        kept = {(identifier, payload): time_s for (_, identifier, payload), time_s in log.times_s.items() if _is_kept(payload)}
        found: dict[str, list[tuple[int, float, float]]] = {}
        for key, time_s in kept.items():
            before = self._known.get(key) if time_s is not None else None
            if time_s is not None and before is not None:
                found.setdefault(before[0], []).append((key[1], time_s, before[1]))
        self._known |= {key: (log.path, time_s) for key, time_s in kept.items() if time_s is not None}
        lines = (_at_other_times(log.path, other, alike) for other, alike in found.items())
        return [line for line in lines if line]

    def take_message(self, message: can.Message) -> None:
        """One of the sensor's frames, as take()."""
        self.take(block_of([message]), np.zeros(1, np.intp))

    def _beginning(self, path: str, part: int) -> _Log:
        """Of frames that another log may hold: until enough of them can be compared, or past the end of all logs before."""
        found, last_s = _Log(path), max(log.last_s for log in self._logs)
        for block in self._looks(path, part):
            rows = np.flatnonzero(np.isin(block.can_id, list(self._identifiers)))
            found.take(*_compared(block, rows))
            beyond = rows.size and float(block.time_s[rows].min()) > last_s + _CLOCKS_S
            if beyond or sum(time_s is not None for time_s in found.times_s.values()) >= _ENOUGH:
                break
        return found

    def _looks(self, path: str, part: int) -> Iterator[FrameBlock]:
        unsaid = LogNotes(on_damage=lambda damage: None)
        try:
            if is_pipe(Path(path)) or not any(log.times_s for log in self._logs):
                return
            for block in islice(iter_blocks(path, unsaid, chunk_bytes=_LOOK_BYTES, part=part), _LOOKS):
                yield block.of_channels(self._channels) if self._channels else block
        except (InputError, OSError):
            # What is wrong is said when it is measured.
            return


def _without_repeats(values: NDArray[Any]) -> NDArray[Any]:
    """The values without those that equal the one before: few are left of a log's, and there is no need to sort them."""
    return values[np.flatnonzero(np.concatenate(([True], values[1:] != values[:-1])))] if values.size else values


def _compared(block: FrameBlock, rows: NDArray[np.intp]) -> tuple[list[_Key], list[float]]:
    """What some of these frames hold, and their times."""
    chosen = rows[(block.payload[rows] * _MULTIPLIER) >> _ALL_BUT_BITS == 0]
    parts = (column[chosen].tolist() for column in (block.channel, block.can_id, block.payload))
    keys = [(block.channels[channel], identifier, payload) for channel, identifier, payload in zip(*parts, strict=True)]
    return keys, block.time_s[chosen].tolist()


def _apart_s(log: _Log, other: _Log) -> tuple[float, float] | None:
    """How much later a log has the frames of another, and how much later than that a frame of it may be, s; None where it holds
    others."""
    pairs = ((time_s, other.times_s.get(key)) for key, time_s in log.times_s.items())
    apart = np.array([time_s - before_s for time_s, before_s in pairs if time_s is not None and before_s is not None])
    if apart.size < _LEAST_ALIKE:
        return None
    middle = float(np.median(apart))
    alike = apart[np.abs(apart - middle) <= _JITTER_S]
    if abs(middle) > _CLOCKS_S or alike.size < max(_LEAST_ALIKE, 0.9 * apart.size):
        return None
    # Few frames are compared; one that is not may be stamped later than all of them.
    return middle, 2.0 * (float(alike.max()) - middle)


def _is_kept(payload: int) -> bool:
    return (payload * int(_MULTIPLIER) >> _KEPT_BIT) % _ONE_IN == 0


def _at_other_times(path: str, other: str, alike: list[tuple[int, float, float]]) -> str:
    """The line about frames that two logs hold; alike: payload, and time in each. "" where they are not one recording, or no
    further apart than two loggers' clocks."""
    if len(alike) < _LEAST_ALIKE:
        return ""
    payloads = np.array([payload for payload, _, _ in alike], np.uint64)
    times_s, before_s = (np.array(column) for column in zip(*((a, b) for _, a, b in alike), strict=True))
    apart_s = times_s - before_s
    middle_s = float(np.median(apart_s))
    steady = np.abs(apart_s - middle_s) <= _JITTER_S + _DRIFT * np.abs(times_s - np.median(times_s))
    if abs(middle_s) <= _CLOCKS_S or steady.sum() < max(_LEAST_ALIKE, 0.9 * steady.size):
        return ""
    values = payloads[steady].view(np.uint8).reshape(-1, 8)
    if sum(len(np.unique(column)) >= _LEAST_VALUES for column in values.T) < _LEAST_MIXED:
        return ""
    first, last = (utc.text(utc.moment(float(end(times_s[steady])))) for end in (np.min, np.max))
    clock = f"by its clock {abs(middle_s):.0f} s {'later' if middle_s > 0 else 'earlier'}"
    return (
        f"{path}: from {first} to {last} it holds the frames of {other} again, {clock}; one clock is wrong, and {COUNTED_TWICE}"
    )
