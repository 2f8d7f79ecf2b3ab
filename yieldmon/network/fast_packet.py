"""Fast packet of NMEA 2000: up to 223 bytes in 32 frames, with no handshake."""

from __future__ import annotations

from dataclasses import dataclass, field

from .identifier import Identifier, Payload

MAX_BYTES = 223
TIMEOUT_S = 0.75
MAX_SESSIONS = 32
_FIRST_PART_BYTES, _PART_BYTES = 6, 7

#: Groups that come as fast packets, as far as this program reads them: a group's number does not say it.
FAST_PACKET_GROUPS = frozenset({126208, 126996, 127489, 129029, 129038, 129039, 129284, 129540, 129794, 129809, 129810})


@dataclass(slots=True)
class _Session:
    size: int
    due_s: float
    data: bytearray = field(default_factory=bytearray)
    next_part: int = 1


class FastPacketReceiver:
    """Reassembles fast packets, the parts of which come in order; at most `max_sessions` at a time, the oldest go first."""

    def __init__(self, max_sessions: int = MAX_SESSIONS) -> None:
        self._max_sessions = max_sessions
        self._sessions: dict[tuple[int, int, int], _Session] = {}
        self.abandoned = 0
        """Packets that lacked a part."""

    def __len__(self) -> int:
        return len(self._sessions)

    def feed(self, parts: Identifier, data: bytes, now_s: float) -> Payload | None:
        """Takes a frame of a fast packet; the whole message where it is the last one."""
        if len(data) != 8:
            return None
        number = data[0] & 0x1F
        key = (parts.source, parts.group, data[0] >> 5)
        session = self._begin(key, data, now_s) if number == 0 else self._follow(key, number, data, now_s)
        if session is None or len(session.data) < session.size:
            return None
        del self._sessions[key]
        return Payload(now_s, parts.group, parts.source, parts.destination, parts.priority, bytes(session.data[: session.size]))

    def _begin(self, key: tuple[int, int, int], data: bytes, now_s: float) -> _Session | None:
        self.abandoned += self._sessions.pop(key, None) is not None
        if not 0 < data[1] <= MAX_BYTES:
            return None
        if len(self._sessions) >= self._max_sessions:
            del self._sessions[next(iter(self._sessions))]
            self.abandoned += 1
        session = self._sessions[key] = _Session(data[1], now_s + TIMEOUT_S, bytearray(data[2:]))
        return session

    def _follow(self, key: tuple[int, int, int], number: int, data: bytes, now_s: float) -> _Session | None:
        session = self._sessions.get(key)
        if session is None:
            return None
        if number != session.next_part or now_s > session.due_s:
            del self._sessions[key]
            self.abandoned += 1
            return None
        session.next_part += 1
        session.due_s = now_s + TIMEOUT_S
        session.data += data[1:]
        return session
