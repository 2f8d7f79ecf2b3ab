"""Complete parameter groups out of any traffic, for whoever only listens: logs, `signals`, mappings of longer groups."""

from __future__ import annotations

from collections.abc import Set as AbstractSet

from yieldmon.identifiers import CLASSIC_BYTES

from .fast_packet import FAST_PACKET_GROUPS, FastPacketReceiver
from .identifier import TRANSPORT_CONNECTION, TRANSPORT_DATA, Identifier, Payload
from .receiving import TransportReceiver

#: Sessions open at a time on a bus that is only listened to.
LISTENING_SESSIONS = 64


class Reassembler:
    """Single frames as they come, transport protocol and fast packets once complete; never answers.

    Parameters
    ----------
    fast_packet_groups : set of int
        Parameter groups that are fast packets.
    transport_groups : set of int, optional
        Parameter groups that are wanted of the transport protocol; None: all.
    """

    def __init__(
        self, fast_packet_groups: AbstractSet[int] = FAST_PACKET_GROUPS, transport_groups: AbstractSet[int] | None = None
    ) -> None:
        self._fast_groups = fast_packet_groups
        self._transport = TransportReceiver(LISTENING_SESSIONS, transport_groups)
        self._fast = FastPacketReceiver(LISTENING_SESSIONS)

    @property
    def incomplete(self) -> int:
        """Messages that were begun and are given up: a part is lost, or there was no space."""
        transport = self._transport
        return transport.abandoned + transport.aborted + transport.refused + self._fast.abandoned

    @property
    def under_way(self) -> int:
        """Messages of which parts are still to come."""
        return len(self._transport) + len(self._fast)

    def feed(self, identifier: int, data: bytes, now_s: float) -> list[Payload]:
        """Takes a frame with a 29-bit identifier; the groups that it completes.

        The connection management and data frames of the transport protocol yield only what they carry. A frame of CAN FD with
        more than eight bytes is whole.
        """
        parts = Identifier.of(identifier)
        if parts.group in (TRANSPORT_CONNECTION, TRANSPORT_DATA):
            self._transport.poll(now_s)
            payload = self._transport.feed(parts, data, now_s).payload
        elif parts.group in self._fast_groups and len(data) <= CLASSIC_BYTES:
            payload = self._fast.feed(parts, data, now_s)
        else:
            payload = Payload(now_s, parts.group, parts.source, parts.destination, parts.priority, bytes(data))
        return [payload] if payload is not None else []
