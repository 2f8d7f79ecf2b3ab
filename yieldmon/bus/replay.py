"""Sending a log's frames again with the log's own timing.

Every frame has an absolute deadline, so that a late one does not delay the rest: what sleeping from frame to frame
loses adds up, this does not.
"""

from __future__ import annotations

import errno
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import can

from yieldmon.bus.filtering import FilterTable
from yieldmon.bus.waiting import send

#: A log may hold frames of two channels slightly out of order; only a larger step back is one of the recorder's clock.
_STEP_BACK_S = 1.0
#: A transmit queue that stays full this long is a bus without listeners, or one that is off.
_SEND_LIMIT_S = 2.0
_SEND_RETRY_S = 0.001
#: What counts as on time in the summary.
ON_TIME_S = 0.005


class Schedule:
    """Seconds from the start of the replay at which a frame is due, from its time in the log.

    speed: log seconds per second, 0 for no waiting at all. skip_gaps_s: longer silences are shortened to this. Where
    the log's clock steps back, the replay goes on from where it was.
    """

    def __init__(self, speed: float = 1.0, skip_gaps_s: float = math.inf) -> None:
        self._speed = speed
        self._skip_gaps_s = skip_gaps_s
        self._latest_s: float | None = None
        self._position_s = 0.0

    def due_s(self, time_s: float) -> float:
        """Due time of the next frame of the log; falls back by at most what the log's frames are out of order."""
        if self._latest_s is None:
            self._latest_s = time_s
        step_s = time_s - self._latest_s
        if -_STEP_BACK_S < step_s < 0:
            return self._scaled(self._position_s + step_s)
        self._latest_s = time_s
        self._position_s += min(max(step_s, 0.0), self._skip_gaps_s)
        return self._scaled(self._position_s)

    @property
    def is_paced(self) -> bool:
        """False where frames go out as fast as they can."""
        return self._speed > 0

    def next_pass(self) -> None:
        """The log begins again: its first frame is due with the last one."""
        self._latest_s = None

    def _scaled(self, position_s: float) -> float:
        return max(position_s, 0.0) / self._speed if self._speed else 0.0


@dataclass(frozen=True)
class Selection:
    """Which frames of a log are sent. Error frames never are.

    from_s, to_s: seconds after the log's first frame, to_s excluded. inputs: just those that these let through, so that a
    log which holds yieldmon's output too can drive it; None: all. channels: names in the log, None for all. fd: send CAN FD
    frames.
    """

    from_s: float = 0.0
    to_s: float = math.inf
    inputs: FilterTable | None = None
    channels: frozenset[str] | None = None
    fd: bool = False

    def of(self, messages: Iterable[can.Message], progress: Progress | None = None) -> Iterator[can.Message]:
        """The selected frames; ends at the first frame at to_s or later. progress: counts frames that are not sent for want of
        `fd` alone."""
        start_s = None
        for message in messages:
            start_s = message.timestamp if start_s is None else start_s
            after_s = message.timestamp - start_s
            if after_s >= self.to_s:
                return
            if after_s < self.from_s or not self._takes(message):
                continue
            if self.fd or not message.is_fd:
                yield message
            elif progress is not None:
                progress.fd_not_sent += 1

    def _takes(self, message: can.Message) -> bool:
        if message.is_error_frame:
            return False
        if self.channels is not None and str(message.channel) not in self.channels:
            return False
        return self.inputs is None or (not message.is_remote_frame and self.inputs.passes(message))


@dataclass
class Progress:
    """How far a replay is; changes while it runs. late: frames sent more than ON_TIME_S after they were due, where they
    were due at all. passes: finished ones. fd_not_sent: CAN FD frames that a classic bus does not take."""

    sent: int = 0
    fd_not_sent: int = 0
    late: int = 0
    worst_lateness_s: float = 0.0
    elapsed_s: float = 0.0
    passes: int = 0

    @property
    def frames_per_s(self) -> float:
        """Mean rate so far."""
        return self.sent / self.elapsed_s if self.elapsed_s > 0 else 0.0


def replay(
    passes: Iterable[Iterable[can.Message]],
    send: Callable[[can.Message], None],
    schedule: Schedule,
    progress: Progress,
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Sends every message of every pass when it is due; `progress` is kept up to date.

    clock: monotonic seconds. Raises what `send` raises; a pass without a single frame ends the replay.
    """
    begun_s = math.inf
    origin_s = -math.inf
    for messages in passes:
        before = progress.sent
        for message in messages:
            position_s = schedule.due_s(message.timestamp)
            if progress.sent == before:
                # Opening a log and passing over its beginning take time that no frame has to make up for.
                origin_s = max(origin_s, clock() - position_s)
                begun_s = min(begun_s, origin_s)
            due_s = origin_s + position_s
            wait_s = due_s - clock()
            if wait_s > 0:
                sleep(wait_s)
            send(message)
            now_s = clock()
            progress.sent += 1
            progress.elapsed_s = now_s - begun_s
            if schedule.is_paced:
                progress.late += now_s - due_s > ON_TIME_S
                progress.worst_lateness_s = max(progress.worst_lateness_s, now_s - due_s)
        if progress.sent == before:
            return
        progress.passes += 1
        schedule.next_pass()


class Sender:
    """Sends on the bus that a frame's channel in the log maps to, waiting while a transmit queue is full."""

    def __init__(
        self,
        buses: Mapping[str | None, can.BusABC],
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """buses: channel in the log -> bus; the key None stands for every other channel."""
        self._buses = buses
        self._clock = clock
        self._sleep = sleep

    def send(self, message: can.Message) -> None:
        """Raises can.CanError when the bus does not take the frame within two seconds, or fails."""
        bus = self._buses.get(str(message.channel)) or self._buses[None]
        message.channel = None
        give_up_s = self._clock() + _SEND_LIMIT_S
        while True:
            try:
                send(bus, message, _SEND_LIMIT_S)
                return
            except can.CanOperationError as error:
                if error.error_code != errno.ENOBUFS or self._clock() >= give_up_s:
                    raise
            self._sleep(_SEND_RETRY_S)
