"""Transport protocol of SAE J1939-21, the sending side: broadcasts (BAM) and connections (RTS/CTS)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from yieldmon.identifiers import GLOBAL_ADDRESS

from .assembly import MAX_BYTES, PART_BYTES, parts_in
from .identifier import TRANSPORT_CONNECTION, TRANSPORT_DATA, Identifier, RawFrame, frame
from .transport import ABORT, BROADCAST, CTS, END_OF_MESSAGE, PRIORITY, RTS, TIMED_OUT, abort, control

BROADCAST_GAP_S = 0.05
"""Between two parts of a broadcast; the standard has 50 to 200 ms."""
T3_S = 1.25
"""Longest wait for an answer after our last part."""
T4_S = 1.05
"""Longest wait after a CTS that asked us to hold."""
MAX_WAITING = 16
#: How often a receiver may ask for parts again in one message.
MAX_REPEATS = 8
_NEVER_S = float("inf")


@dataclass(slots=True)
class _Message:
    group: int
    data: bytes
    next_part: int = 0
    """0: not yet announced."""
    due_s: float = _NEVER_S
    repeats: int = 0


class TransportSender:
    """Sends messages of 9 to 1785 bytes: one broadcast at a time, one connection a destination at a time.

    At most `max_waiting` broadcasts wait or are under way, and as many messages to single nodes: peers that ask and do not answer
    keep no broadcast out. Beyond them new ones are refused.
    """

    def __init__(self, max_waiting: int = MAX_WAITING) -> None:
        self._max_waiting = max_waiting
        self._queues: dict[int, deque[_Message]] = {}
        self.refused = 0
        """Messages for which there was no space."""
        self.failed = 0
        """Connections that were aborted or not answered."""

    def __len__(self) -> int:
        return sum(len(queue) for queue in self._queues.values())

    @property
    def due_s(self) -> float:
        """When poll() has something to do, infinite while it has not."""
        return min(queue[0].due_s for queue in self._queues.values()) if self._queues else _NEVER_S

    def busy_with(self, group: int, destination: int = GLOBAL_ADDRESS) -> bool:
        """Whether a message of a group waits or is under way to a destination."""
        return any(message.group == group for message in self._queues.get(destination, ()))

    def submit(self, group: int, data: bytes, source: int, destination: int, now_s: float) -> list[RawFrame]:
        """Begin to send, or queue behind what is under way to the same destination; [] too where there is no space.

        Raises ValueError for a message that one frame or no transfer can carry.
        """
        if not 8 < len(data) <= MAX_BYTES:
            raise ValueError(f"message of {len(data)} bytes, expected 9 to {MAX_BYTES}")
        broadcast = destination == GLOBAL_ADDRESS
        if sum(len(queue) for to, queue in self._queues.items() if (to == GLOBAL_ADDRESS) == broadcast) >= self._max_waiting:
            self.refused += 1
            return []
        queue = self._queues.setdefault(destination, deque())
        queue.append(_Message(group, bytes(data)))
        return self._open(destination, source, now_s) if len(queue) == 1 else []

    def clear(self) -> None:
        """Forget everything: our address has gone."""
        self._queues.clear()

    def feed(self, parts: Identifier, data: bytes, source: int, now_s: float) -> list[RawFrame]:
        """Takes a frame of connection management addressed to us (source: our address)."""
        if parts.group != TRANSPORT_CONNECTION or parts.destination != source or len(data) != 8:
            return []
        queue = self._queues.get(parts.source)
        if not queue or queue[0].group != int.from_bytes(data[5:8], "little"):
            return []
        message, kind = queue[0], data[0]
        if kind == CTS:
            return self._clear_to_send(message, parts.source, data, source, now_s)
        if kind == END_OF_MESSAGE:
            return self._next(parts.source, source, now_s)
        if kind == ABORT:
            self.failed += 1
            return self._next(parts.source, source, now_s)
        return []

    def poll(self, source: int, now_s: float) -> list[RawFrame]:
        """Parts of broadcasts that are due, and aborts of connections without an answer."""
        out: list[RawFrame] = []
        for destination in [d for d, queue in self._queues.items() if now_s >= queue[0].due_s]:
            message = self._queues[destination][0]
            if destination == GLOBAL_ADDRESS:
                out += self._broadcast_part(message, source, now_s)
            else:
                self.failed += 1
                out.append(abort(message.group, TIMED_OUT, source, destination))
                out += self._next(destination, source, now_s)
        return out

    def _open(self, destination: int, source: int, now_s: float) -> list[RawFrame]:
        message = self._queues[destination][0]
        message.next_part = 1
        broadcast = destination == GLOBAL_ADDRESS
        message.due_s = now_s + (BROADCAST_GAP_S if broadcast else T3_S)
        size = len(message.data)
        kind = BROADCAST if broadcast else RTS
        head = bytes([kind, *size.to_bytes(2, "little"), parts_in(size)])
        return [control(message.group, head, source, destination)]

    def _next(self, destination: int, source: int, now_s: float) -> list[RawFrame]:
        queue = self._queues[destination]
        queue.popleft()
        if queue:
            return self._open(destination, source, now_s)
        del self._queues[destination]
        return []

    def _broadcast_part(self, message: _Message, source: int, now_s: float) -> list[RawFrame]:
        if message.next_part == 0:
            return self._open(GLOBAL_ADDRESS, source, now_s)
        out = [_part(message, message.next_part, source, GLOBAL_ADDRESS)]
        message.next_part += 1
        message.due_s = now_s + BROADCAST_GAP_S
        if message.next_part > parts_in(len(message.data)):
            queue = self._queues[GLOBAL_ADDRESS]
            queue.popleft()
            if queue:
                # The next announcement keeps the same distance.
                queue[0].due_s = now_s + BROADCAST_GAP_S
            else:
                del self._queues[GLOBAL_ADDRESS]
        return out

    def _clear_to_send(self, message: _Message, destination: int, data: bytes, source: int, now_s: float) -> list[RawFrame]:
        count, first = data[1], data[2]
        if count == 0:
            message.due_s = now_s + T4_S
            return []
        total = parts_in(len(message.data))
        if not 1 <= first <= total:
            return []
        if first < message.next_part:
            message.repeats += 1
            if message.repeats > MAX_REPEATS:
                self.failed += 1
                return self._next(destination, source, now_s)
        last = min(first + count - 1, total)
        message.next_part = last + 1
        message.due_s = now_s + T3_S
        return [_part(message, number, source, destination) for number in range(first, last + 1)]


def _part(message: _Message, number: int, source: int, destination: int) -> RawFrame:
    at = (number - 1) * PART_BYTES
    part = message.data[at : at + PART_BYTES].ljust(PART_BYTES, b"\xff")
    return frame(TRANSPORT_DATA, bytes([number]) + part, source, destination, PRIORITY)
