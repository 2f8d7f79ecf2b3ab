"""The receive thread: takes frames off the bus as they come, whatever the consumer is busy with.

Waking two threads for each frame costs several times what the frame itself does. Where the kernel stamps and keeps the frames
nothing is lost by fetching them some at a time, as long as the one that the consumer waits for is fetched at once.
"""

from __future__ import annotations

import errno
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum

import can

from yieldmon.bus.error_frames import ErrorKind, describe, kind_of
from yieldmon.bus.filtering import FilterTable
from yieldmon.bus.opening import kept_by_the_kernel, kernel_drops_of
from yieldmon.bus.waiting import receive, receive_kept, send

_log = logging.getLogger(__name__)

#: Frames: over 10 s of a 250 kbit/s bus that is full.
DEFAULT_CAPACITY = 20_000
#: One read of the bus waits so long for a frame, and a stop for that read.
LISTEN_S = 0.1
#: The kernel reports a lost interface to a socket once: if sending got the report, receiving would wait for ever.
_INTERFACE_GONE = frozenset({errno.ENETDOWN, errno.ENODEV, errno.ENXIO})
_FIRST_RETRY_S = 0.05
_LAST_RETRY_S = 0.8
#: Events that may wait beside `capacity` frames; beyond, they are counted only.
_EVENT_RESERVE = 1_000
#: Frames between two looks at the kernel's drop count while the bus never falls silent.
_DROP_CHECK_FRAMES = 500
#: Rest between two fetches of what the kernel has kept: 54 frames of a full 250 kbit/s bus.
_NAP_S = 0.03
#: How much earlier than due a rest ends, and the shortest one that is worth it.
_NAP_MARGIN_S = 0.001
_BATCH_FRAMES = 256
#: How long a stop waits for a read that hangs.
_STOP_S = 1.0


class BusEventKind(Enum):
    """What happened on the bus beside frames."""

    BUS_ERROR = "bus error"
    BUS_OFF = "bus off"
    BUS_RESTARTED = "bus restarted"
    INTERFACE_LOST = "interface lost"
    INTERFACE_RESTORED = "interface restored"
    FRAMES_DROPPED = "frames dropped"
    """The consumer did not keep up, or the kernel or the controller lost frames; `count` of them at this place."""
    RECEIVER_FAILED = "receiver failed"
    """An unforeseen error; the receiver closes the bus, opens it again and goes on."""


@dataclass(frozen=True)
class BusEvent:
    """An event in its place among the frames. time_s: seconds, the bus's clock for error frames, else the system's."""

    kind: BusEventKind
    time_s: float
    detail: str = ""
    count: int = 1


@dataclass(frozen=True)
class ReceiverCounters:
    """Since start. `received` counts what the bus gave, data and remote frames; of these `dropped` never reached the
    consumer. `kernel_drops` never reached the receiver."""

    received: int = 0
    dropped: int = 0
    kernel_drops: int = 0
    error_frames: int = 0
    bus_offs: int = 0
    interface_losses: int = 0
    failures: int = 0


_ERROR_EVENTS = {
    ErrorKind.BUS_ERROR: BusEventKind.BUS_ERROR,
    ErrorKind.BUS_OFF: BusEventKind.BUS_OFF,
    ErrorKind.RESTARTED: BusEventKind.BUS_RESTARTED,
    ErrorKind.OVERFLOW: BusEventKind.FRAMES_DROPPED,
}

Item = can.Message | BusEvent


class Receiver:
    """Reads a bus on a thread of its own into a bounded queue; opens the bus again when the interface has gone.

    Use as a context manager, or start() and stop(). Frames and events come out of get() in the order in which they
    happened. When the queue is full new frames are dropped and counted, and an event marks the place.
    """

    def __init__(
        self,
        open_bus: Callable[[], can.BusABC],
        *,
        capacity: int = DEFAULT_CAPACITY,
        listen_s: float = LISTEN_S,
        clock: Callable[[], float] = time.time,
    ) -> None:
        """open_bus: opens the bus anew each time it is called, raises can.CanError or OSError when it cannot.
        capacity: frames that may wait for the consumer. listen_s: one read waits so long for a frame, and a stop for it.
        clock: what the bus stamps frames by, s; the times of events that are not a frame."""
        self._listen_s = listen_s
        self._clock = clock
        self._open_bus = open_bus
        self._capacity = capacity
        self._queue: deque[Item] = deque()
        self._changed = threading.Condition()
        self._stopping = threading.Event()
        self._woken = False
        self._received = self._dropped = self._error_frames = self._bus_offs = 0
        self._interface_losses = self._failures = 0
        self._dropped_here = 0
        self._drops_of_closed_buses = 0
        self._drops_seen = 0
        self._bus: can.BusABC | None = None
        self._found_gone: tuple[can.BusABC | None, str] = (None, "")
        self._thread: threading.Thread | None = None
        self.due_s = float("-inf")
        """Time of the first frame that the consumer wants at once, on the bus's clock; those before it may wait a little."""
        self.empty_until_s = float("-inf")
        """Monotonic time up to which the bus is known to have brought nothing beyond what is in the queue. That a queue is empty
        says less: after a stall the consumer may be back before this thread is."""
        self._beat_s = time.monotonic()

    def __enter__(self) -> Receiver:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def start(self) -> None:
        """Opens the bus and starts reading. Raises what open_bus raises: only a bus that was there is waited for."""
        if self._thread is not None:
            raise RuntimeError("a receiver can be started once")
        self._bus = self._open_bus()
        self._thread = threading.Thread(target=self._run, name="can-receiver", daemon=True)
        self._thread.start()

    def stop(self, timeout_s: float = _STOP_S) -> None:
        """Ends the thread and closes the bus; what has been received can still be fetched. A thread that does not end within
        timeout_s seconds is left to itself."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(timeout_s)
        self._close_bus()
        with self._changed:
            self._changed.notify_all()

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread is not None and self._thread.is_alive()

    def hangs_s(self) -> float:
        """For how long the thread has shown no sign of life, s; it gives one several times a second."""
        return time.monotonic() - self._beat_s

    @property
    def waiting(self) -> int:
        """Frames and events that have not been taken yet."""
        return len(self._queue)

    @property
    def bus(self) -> can.BusABC | None:
        """The open bus, None while the interface is away."""
        return self._bus

    def send(self, message: can.Message, timeout_s: float | None = None) -> None:
        """Sends on the same bus. Raises can.CanError when that fails or the interface is away."""
        bus = self._bus
        if bus is None:
            raise can.CanOperationError("the interface is away")
        try:
            send(bus, message, timeout_s)
        except can.CanError as error:
            if error.error_code in _INTERFACE_GONE:
                self._found_gone = (bus, str(error))
            raise
        except (OSError, ValueError) as error:
            raise can.CanOperationError(f"failed to transmit: {error}") from error

    def get(self, timeout_s: float | None = None) -> Item | None:
        """The next frame or event; None when none came within timeout_s seconds or the receiver has stopped."""
        items = self.get_many(1, timeout_s)
        return items[0] if items else None

    def wake(self) -> None:
        """End the wait for frames of a consumer, or its next one; from any thread."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def get_many(self, limit: int, timeout_s: float | None = None) -> list[Item]:
        """Up to `limit` frames and events as soon as there is one; empty as for get(), and after `wake`."""
        with self._changed:
            self._changed.wait_for(lambda: self._queue or self._woken or self._stopping.is_set(), timeout_s)
            self._woken = False
            return [self._queue.popleft() for _ in range(min(limit, len(self._queue)))]

    def counters(self) -> ReceiverCounters:
        """A consistent copy of the counters."""
        with self._changed:
            return ReceiverCounters(
                received=self._received,
                dropped=self._dropped,
                kernel_drops=self._drops_seen,
                error_frames=self._error_frames,
                bus_offs=self._bus_offs,
                interface_losses=self._interface_losses,
                failures=self._failures,
            )

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._read_until_lost()
            except (can.CanError, OSError, ValueError) as error:
                # ValueError: select() on a descriptor that another thread closed.
                self._lost(BusEventKind.INTERFACE_LOST, str(error))
            except Exception as error:  # noqa: BLE001 - a thread that dies in silence would look like a silent bus
                _log.exception("receive thread")
                self._lost(BusEventKind.RECEIVER_FAILED, f"{type(error).__name__}: {error}")

    def _read_until_lost(self) -> None:
        if self._bus is None:
            self._reopen()
        bus = self._bus
        in_batches = bus is not None and kept_by_the_kernel(bus)
        passes = FilterTable(bus.filters if bus is not None else None).passes
        unchecked = 0
        while bus is not None and not self._stopping.is_set():
            gone_bus, problem = self._found_gone
            if gone_bus is bus:
                raise can.CanOperationError(problem)
            taken = self._fetch(bus, passes, _BATCH_FRAMES if in_batches else 1)
            unchecked += taken
            if not taken or unchecked >= _DROP_CHECK_FRAMES:
                self._check_kernel_drops()
                unchecked = 0
            if in_batches and 0 < taken < _BATCH_FRAMES:
                rest_s = nap_s(self.due_s, self._clock())
                if rest_s > 0.0:
                    self._stopping.wait(rest_s)

    def _fetch(self, bus: can.BusABC, passes: Callable[[can.Message], bool], limit: int) -> int:
        """Waits for a frame and takes it and those waiting behind it; returns how many came, `limit` at most."""
        messages: list[can.Message] = []
        asked_s = self._beat_s = time.monotonic()
        try:
            message = receive(bus, self._listen_s, passes)
            if message is None:
                self.empty_until_s = asked_s + self._listen_s
            else:
                messages.append(message)
                for kept in receive_kept(bus, limit - 1, passes):
                    messages.append(kept)
        finally:
            # The interface may have gone behind the last of them.
            if messages:
                self._take(messages)
        return len(messages)

    def _reopen(self) -> None:
        """Tries until the interface is back and readable, then says so; returns with no bus when asked to stop."""
        delay_s = _FIRST_RETRY_S
        while not self._stopping.wait(delay_s):
            delay_s = min(2 * delay_s, _LAST_RETRY_S)
            self.empty_until_s = self._beat_s = time.monotonic()
            bus = None
            try:
                bus = self._open_bus()
                # An interface that exists but is down lets itself be opened and fails at the first read.
                message = receive(bus, 0.0)
            except (can.CanError, OSError, ValueError) as error:
                _log.debug("not back yet: %s", error)
                if bus is not None:
                    _shut(bus)
                continue
            except BaseException:
                # `_run` reports it; the bus that was opened would be kept by nobody.
                if bus is not None:
                    _shut(bus)
                raise
            self._bus = bus
            self._put_event(BusEvent(BusEventKind.INTERFACE_RESTORED, self._clock()))
            _log.info("%s: interface restored", bus.channel_info)
            if message is not None:
                self._take([message])
            return

    def _lost(self, kind: BusEventKind, detail: str) -> None:
        self._close_bus()
        with self._changed:
            if kind is BusEventKind.INTERFACE_LOST:
                self._interface_losses += 1
            else:
                self._failures += 1
        if not self._stopping.is_set():
            _log.warning("%s: %s", kind.value, detail)
            self._put_event(BusEvent(kind, self._clock(), detail))

    def _take(self, messages: list[can.Message]) -> None:
        with self._changed:
            for message in messages:
                if message.is_error_frame:
                    self._take_error(message)
                    continue
                self._received += 1
                if len(self._queue) >= self._capacity:
                    self._dropped += 1
                    self._dropped_here += 1
                    continue
                if self._dropped_here:
                    self._mark_drops()
                self._queue.append(message)
            self._changed.notify()

    def _take_error(self, message: can.Message) -> None:
        """Holds the lock already."""
        kind = kind_of(message)
        self._error_frames += 1
        self._bus_offs += kind is ErrorKind.BUS_OFF
        self._put_event(BusEvent(_ERROR_EVENTS[kind], message.timestamp, describe(message)))

    def _put_event(self, event: BusEvent) -> None:
        with self._changed:
            self._mark_drops()
            last = self._queue[-1] if self._queue else None
            if isinstance(last, BusEvent) and last.kind is event.kind and last.detail == event.detail:
                # A broken bus sends error frames without end: one entry with a count keeps the queue bounded.
                self._queue[-1] = replace(last, count=last.count + event.count)
            elif len(self._queue) < self._capacity + _EVENT_RESERVE:
                self._queue.append(event)
            self._changed.notify()

    def _mark_drops(self) -> None:
        """Puts the mark for frames dropped since the last item; holds the lock already."""
        if self._dropped_here:
            detail = "the consumer did not keep up"
            self._queue.append(BusEvent(BusEventKind.FRAMES_DROPPED, self._clock(), detail, self._dropped_here))
            self._dropped_here = 0

    def _check_kernel_drops(self) -> None:
        drops = kernel_drops_of(self._bus) if self._bus is not None else None
        if drops is None:
            return
        with self._changed:
            new = self._drops_of_closed_buses + drops - self._drops_seen
            self._drops_seen += new
        if new > 0:
            detail = "the kernel's receive buffer was full"
            self._put_event(BusEvent(BusEventKind.FRAMES_DROPPED, self._clock(), detail, new))

    def _close_bus(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            with self._changed:
                self._drops_of_closed_buses += kernel_drops_of(bus) or 0
            _shut(bus)


def nap_s(due_s: float, now_s: float) -> float:
    """How long the receiver may rest, s, when the consumer waits for a frame of time due_s; times on the bus's clock.

    Never longer than _NAP_S, whatever a clock that was set makes of the difference.
    """
    left_s = due_s - now_s - _NAP_MARGIN_S
    return min(_NAP_S, left_s) if left_s >= _NAP_MARGIN_S else 0.0


def _shut(bus: can.BusABC) -> None:
    # Closing what has already gone may fail; there is nothing left to do about it.
    with suppress(can.CanError, OSError, ValueError):
        bus.shutdown()
