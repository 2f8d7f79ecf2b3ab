"""Transport protocol of SAE J1939-21, the receiving side: broadcasts (BAM), and connections (RTS/CTS) to us or to others."""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field

from yieldmon.identifiers import GLOBAL_ADDRESS

from .assembly import MAX_BYTES, Assembly, parts_in
from .identifier import TRANSPORT_CONNECTION, TRANSPORT_DATA, Identifier, Payload, RawFrame
from .transport import ABORT, BAD_SEQUENCE, BROADCAST, BUSY, CTS, END_OF_MESSAGE, NO_RESOURCES, RTS, TIMED_OUT, abort, control

T1_S = 0.75
"""Longest time between two parts."""
T2_S = 1.25
"""Longest time from our CTS to the first part, and between two frames of others' connections, in which either side may wait."""
MAX_SESSIONS = 16
#: Parts that we let a sender send at a time.
WINDOW_PARTS = 16
MAX_REPEATS = 2
_NEVER_S = float("inf")


@dataclass(slots=True)
class _Session:
    group: int
    assembly: Assembly
    due_s: float
    priority: int
    to_us: bool = False
    window: int = 0
    """Last part that our latest CTS let through."""
    limit: int = WINDOW_PARTS
    repeats: int = 0
    asked_again: bool = False


@dataclass(frozen=True, slots=True)
class Received:
    """Frames to answer with, and the message that the frame completed."""

    frames: list[RawFrame] = field(default_factory=list)
    payload: Payload | None = None


_NOTHING = Received()


class TransportReceiver:
    """Reassembles every session that it receives, and answers those addressed to us.

    One session for each pair of sender and destination; a new one replaces it, as the sender has begun anew. At most
    `max_sessions` are open: beyond them a connection to us is refused and others are passed over.

    Parameters
    ----------
    max_sessions : int
    groups : set of int, optional
        Parameter groups that are wanted; sessions of others are passed over. None: all are.
    """

    def __init__(self, max_sessions: int = MAX_SESSIONS, groups: AbstractSet[int] | None = None) -> None:
        self._max_sessions = max_sessions
        self._groups = groups
        self._sessions: dict[tuple[int, int], _Session] = {}
        self.refused = 0
        """Sessions for which there was no space."""
        self.abandoned = 0
        """Sessions that were begun and not ended in time."""
        self.aborted = 0
        """Sessions that sender or receiver ended early."""

    def __len__(self) -> int:
        return len(self._sessions)

    @property
    def due_s(self) -> float:
        """When poll() has something to do, infinite while it has not."""
        return min(session.due_s for session in self._sessions.values()) if self._sessions else _NEVER_S

    def feed(self, parts: Identifier, data: bytes, now_s: float, our_address: int | None = None) -> Received:
        """Takes a frame of the transport protocol; any other is passed over."""
        if len(data) != 8 or (parts.source == our_address and our_address is not None):
            return _NOTHING
        if parts.group == TRANSPORT_DATA:
            return self._take_data(parts, data, now_s)
        if parts.group == TRANSPORT_CONNECTION:
            return self._take_control(parts, data, now_s, our_address)
        return _NOTHING

    def forget_ours(self) -> None:
        """Drop the sessions addressed to us: the address that they name is not ours any more."""
        for key in [key for key, session in self._sessions.items() if session.to_us]:
            del self._sessions[key]

    def poll(self, now_s: float) -> list[RawFrame]:
        """Ends the sessions whose time is up; the aborts of those that were for us."""
        out: list[RawFrame] = []
        for key in [key for key, session in self._sessions.items() if now_s >= session.due_s]:
            session = self._sessions.pop(key)
            self.abandoned += 1
            if session.to_us:
                out.append(abort(session.group, TIMED_OUT, source=key[1], destination=key[0]))
        return out

    def _take_control(self, parts: Identifier, data: bytes, now_s: float, our_address: int | None) -> Received:
        kind, group = data[0], int.from_bytes(data[5:8], "little")
        key = (parts.source, parts.destination)
        if kind == ABORT:
            # Either side may end a session; that of another group the other way goes on.
            for ended in (key, (parts.destination, parts.source)):
                session = self._sessions.get(ended)
                if session is not None and session.group == group:
                    del self._sessions[ended]
                    self.aborted += 1
        elif kind == CTS:
            session = self._sessions.get((parts.destination, parts.source))
            if session is not None and session.group == group:
                session.due_s = now_s + T2_S
        elif kind in (RTS, BROADCAST) and (kind == BROADCAST) == (parts.destination == GLOBAL_ADDRESS):
            return self._open(parts, data, group, now_s, our_address)
        return _NOTHING

    def _open(self, parts: Identifier, data: bytes, group: int, now_s: float, our_address: int | None) -> Received:
        key = (parts.source, parts.destination)
        to_us = our_address is not None and parts.destination == our_address
        size, count = int.from_bytes(data[1:3], "little"), data[3]
        self.abandoned += self._sessions.pop(key, None) is not None
        if self._groups is not None and group not in self._groups:
            return _NOTHING
        refusal = None
        if not 8 < size <= MAX_BYTES or count != parts_in(size):
            refusal = NO_RESOURCES
        elif len(self._sessions) >= self._max_sessions:
            self.refused += 1
            refusal = BUSY
        if refusal is not None:
            answer = [abort(group, refusal, source=parts.destination, destination=parts.source)] if to_us else []
            return Received(answer)
        wait_s = T1_S if parts.destination == GLOBAL_ADDRESS else T2_S
        session = _Session(group, Assembly(size), now_s + wait_s, parts.priority, to_us)
        self._sessions[key] = session
        if not to_us:
            return _NOTHING
        session.limit = min(WINDOW_PARTS, data[4] or WINDOW_PARTS)
        return Received([_clear_to_send(key, session)])

    def _take_data(self, parts: Identifier, data: bytes, now_s: float) -> Received:
        key = (parts.source, parts.destination)
        session = self._sessions.get(key)
        if session is None:
            return _NOTHING
        number = data[0]
        expected = session.assembly.first_missing
        if session.to_us and number != expected:
            return self._out_of_order(key, session, number, expected or 0)
        if parts.destination == GLOBAL_ADDRESS and number != expected:
            # A broadcast is never repeated in part: what follows a lost part may be of the next one.
            del self._sessions[key]
            self.abandoned += 1
            return _NOTHING
        session.assembly.put(number, data[1:])
        session.due_s = now_s + (T1_S if session.to_us or parts.destination == GLOBAL_ADDRESS else T2_S)
        session.asked_again = False
        following = session.assembly.first_missing
        if following is None:
            return self._complete(key, session, parts, now_s)
        if session.to_us and following > session.window:
            session.due_s = now_s + T2_S
            return Received([_clear_to_send(key, session)])
        return _NOTHING

    def _out_of_order(self, key: tuple[int, int], session: _Session, number: int, expected: int) -> Received:
        """A part was lost: ask for it once, twice; parts under way behind the gap come again anyway."""
        if number < expected or session.asked_again:
            return _NOTHING
        session.repeats += 1
        if session.repeats > MAX_REPEATS:
            del self._sessions[key]
            return Received([abort(session.group, BAD_SEQUENCE, source=key[1], destination=key[0])])
        session.asked_again = True
        return Received([_clear_to_send(key, session)])

    def _complete(self, key: tuple[int, int], session: _Session, parts: Identifier, now_s: float) -> Received:
        del self._sessions[key]
        assembly = session.assembly
        payload = Payload(now_s, session.group, parts.source, parts.destination, session.priority, assembly.data)
        if not session.to_us:
            return Received([], payload)
        head = bytes([END_OF_MESSAGE, *assembly.size.to_bytes(2, "little"), assembly.parts])
        return Received([control(session.group, head, source=key[1], destination=key[0])], payload)


def _clear_to_send(key: tuple[int, int], session: _Session) -> RawFrame:
    first = session.assembly.first_missing or 1
    count = min(session.limit, session.assembly.parts - first + 1)
    session.window = first + count - 1
    return control(session.group, bytes([CTS, count, first]), source=key[1], destination=key[0])
