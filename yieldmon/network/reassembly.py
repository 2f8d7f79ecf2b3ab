"""Complete parameter groups out of any traffic, for whoever only listens: logs, `signals`, mappings of longer groups."""

from __future__ import annotations

from collections.abc import Set as AbstractSet

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
    """

    def __init__(self, fast_packet_groups: AbstractSet[int] = FAST_PACKET_GROUPS) -> None:
        self._fast_groups = fast_packet_groups
        self._transport = TransportReceiver(LISTENING_SESSIONS)
        self._fast = FastPacketReceiver(LISTENING_SESSIONS)

    def feed(self, identifier: int, data: bytes, now_s: float) -> list[Payload]:
        """Takes a frame with a 29-bit identifier; the groups that it completes.

        The connection management and data frames of the transport protocol yield only what they carry.
        """
        parts = Identifier.of(identifier)
        if parts.group in (TRANSPORT_CONNECTION, TRANSPORT_DATA):
            self._transport.poll(now_s)
            payload = self._transport.feed(parts, data, now_s).payload
        elif parts.group in self._fast_groups:
            payload = self._fast.feed(parts, data, now_s)
        else:
            payload = Payload(now_s, parts.group, parts.source, parts.destination, parts.priority, bytes(data))
        return [payload] if payload is not None else []
