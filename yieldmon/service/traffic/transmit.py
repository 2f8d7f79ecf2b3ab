"""The transmit thread: frames go out in order; what cannot go in time does not go at all."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import monotonic

import can

from yieldmon.service.traffic.echoes import ECHO_S, Echoes

_log = logging.getLogger(__name__)

_SEND_TIMEOUT_S = 0.2
_FAILURE_HOLD_S = 2.0
#: How long a stop waits for the frame that is being sent.
_STOP_S = 1.0


@dataclass(frozen=True)
class TransmitCounters:
    """Since start. `late` frames grew too old or did not fit in the queue; `failed` ones the bus refused."""

    sent: int = 0
    late: int = 0
    failed: int = 0
    last_failure: str = ""
    last_failure_at_s: float = float("-inf")
    last_late_at_s: float = float("-inf")

    def late_now(self, now_s: float) -> bool:
        """Whether a frame grew too old within the last two seconds before now_s (monotonic)."""
        return now_s - self.last_late_at_s < _FAILURE_HOLD_S

    def failing(self, now_s: float) -> bool:
        """Whether a frame was refused within the last two seconds before now_s (monotonic)."""
        return now_s - self.last_failure_at_s < _FAILURE_HOLD_S


class Transmitter:
    """Sends on its own thread, so that a full bus never holds up the engine.

    Attributes
    ----------
    echoes : Echoes
        What was sent and has not come back.
    """

    def __init__(
        self,
        send: Callable[[can.Message, float | None], None],
        capacity: int,
        max_age_s: float,
        clock: Callable[[], float] = monotonic,
        echo_s: float = ECHO_S,
    ) -> None:
        """send: sends one frame, waiting as long as its second argument says; raises can.CanError or OSError.
        capacity: frames that may wait; beyond it the oldest go. max_age_s: a frame that waited longer is not sent.
        echo_s: as `Echoes` has it."""
        self._send = send
        self._clock = clock
        self._capacity = capacity
        self._max_age_s = max_age_s
        self._queue: deque[tuple[float, can.Message]] = deque()
        self.echoes = Echoes(clock, echo_s)
        self._changed = threading.Condition()
        self._stopping = False
        self._busy_since_s: float | None = None
        self._counters = TransmitCounters()
        self._thread = threading.Thread(target=self._run, name="can-transmitter", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def submit(self, *messages: can.Message) -> None:
        """Queue frames, in their order; returns at once."""
        if not messages:
            return
        with self._changed:
            for message in messages:
                if len(self._queue) >= self._capacity:
                    self._queue.popleft()
                    self._counters = replace(self._counters, late=self._counters.late + 1, last_late_at_s=self._clock())
                self._queue.append((self._clock(), message))
            self._changed.notify_all()

    def wait_until_sent(self, timeout_s: float) -> bool:
        """Let the thread send all that waits; False when some still waits after timeout_s seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._queue and self._busy_since_s is None, timeout_s)

    def stop(self, timeout_s: float = _STOP_S) -> bool:
        """Send what is still fresh and end the thread; False when it did not end within timeout_s seconds."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def hangs_s(self) -> float:
        """For how long the thread has been sending one frame, s; 0 while it waits for one."""
        since_s = self._busy_since_s
        return 0.0 if since_s is None else self._clock() - since_s

    @property
    def waiting(self) -> int:
        """Frames that wait to be sent."""
        return len(self._queue)

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def counters(self) -> TransmitCounters:
        """A consistent copy of the counters."""
        return self._counters

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy_since_s = None
                if not self._queue:
                    self._changed.notify_all()
                self._changed.wait_for(lambda: self._queue or self._stopping)
                if not self._queue:
                    return
                queued_at_s, message = self._queue.popleft()
                self._busy_since_s = self._clock()
            if self._clock() - queued_at_s > self._max_age_s:
                self._count(late=1)
                continue
            sent = self.echoes.expect(message)
            try:
                self._send(message, _SEND_TIMEOUT_S)
            except (can.CanError, OSError, ValueError) as error:
                self.echoes.forget(sent)
                self._count(failed=1, failure=str(error))
            else:
                self._count(sent=1)

    def _count(self, sent: int = 0, late: int = 0, failed: int = 0, failure: str = "") -> None:
        with self._changed:
            before = self._counters
            if failed and not before.failing(self._clock()):
                _log.warning("transmit: %s", failure)
            now_s = self._clock()
            self._counters = TransmitCounters(
                sent=before.sent + sent,
                late=before.late + late,
                failed=before.failed + failed,
                last_failure=failure or before.last_failure,
                last_failure_at_s=now_s if failed else before.last_failure_at_s,
                last_late_at_s=now_s if late else before.last_late_at_s,
            )
