"""Messages of more than eight bytes out of a bus's frames: of the transport protocol, of fast packets, and of CAN FD.

A group of more than eight bytes that comes in frames of its own identifier is a fast packet; SAE J1939 has no such frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.databases import MessageBits
from yieldmon.identifiers import CLASSIC_BYTES, EXTENDED_FLAG, FORMAT_MASK, LARGEST_EXTENDED_ID, group_of
from yieldmon.network.identifier import TRANSPORT_CONNECTION, TRANSPORT_DATA, Identifier
from yieldmon.network.reassembly import Reassembler

TRANSPORT = tuple(group << 8 | EXTENDED_FLAG for group in (TRANSPORT_CONNECTION, TRANSPORT_DATA))
TRANSPORT_MASK = FORMAT_MASK | EXTENDED_FLAG
PRIORITY = 0x1C000000
Numbers = Callable[[int], NDArray[np.uint64]]
"""First byte -> the eight bytes from there on of each message (n,), the first one lowest."""


class Whole(NamedTuple):
    """A complete message. identifier: with `EXTENDED_FLAG`; of the transport protocol, which does not carry the priority,
    that of its group, sender and destination. row: of the frame that completed it, in its block."""

    identifier: int
    by_transport: bool
    data: bytes
    row: int = 0


class LongMessages:
    """Puts these messages together, one bus's frames in order; what is begun and not ended is dropped, counted and bounded.

    direct: (identity, mask) of frames of the messages' own identifiers that are taken; None: all of their groups.
    """

    def __init__(self, messages: Iterable[MessageBits], direct: Sequence[tuple[int, int]] | None = None) -> None:
        self._direct = direct
        wanted = [message for message in messages if message.is_long]
        self._standard = frozenset(message.frame_id for message in wanted if not message.extended)
        self._groups = frozenset(message.group for message in wanted if message.extended)
        self._reassembler = Reassembler(self._groups, self._groups)

    @property
    def incomplete(self) -> int:
        """Messages that were begun and are given up."""
        return self._reassembler.incomplete

    @property
    def under_way(self) -> int:
        """Messages of which parts are still to come."""
        return self._reassembler.under_way

    @property
    def by_transport(self) -> bool:
        """Whether one of them may come by the transport protocol."""
        return bool(self._groups)

    def takes(self, identifier: int) -> bool:
        """Whether frames with this identifier, with `EXTENDED_FLAG`, may be of one of the messages."""
        if self._groups and identifier & TRANSPORT_MASK in TRANSPORT:
            return True
        if self._direct is not None:
            return any(identifier & mask == identity for identity, mask in self._direct)
        if identifier & EXTENDED_FLAG:
            return group_of(identifier & LARGEST_EXTENDED_ID) in self._groups
        return identifier in self._standard

    def feed(self, time_s: float, identifier: int, data: bytes) -> Whole | None:
        """The message that a frame which is taken completes."""
        if not identifier & EXTENDED_FLAG:
            return Whole(identifier, by_transport=False, data=data)
        for payload in self._reassembler.feed(identifier & LARGEST_EXTENDED_ID, data, time_s):
            parts = Identifier(payload.priority, payload.group, payload.destination, payload.source)
            return Whole(parts.value | EXTENDED_FLAG, identifier & TRANSPORT_MASK in TRANSPORT, payload.data)
        return None

    def feed_block(
        self,
        time_s: NDArray[np.float64],
        identifiers: NDArray[np.uint32],
        lengths: NDArray[np.uint8],
        payloads: NDArray[np.uint64],
        long: Mapping[int, bytes],
    ) -> list[Whole]:
        """The same for a block: `bulk.FrameBlock`'s columns, of data frames."""
        taken = [identifier for identifier in np.unique(identifiers).tolist() if self.takes(identifier)]
        rows = np.flatnonzero(np.isin(identifiers, np.array(taken, np.uint32))) if taken else np.empty(0, np.intp)
        whole = []
        for row in rows.tolist():
            data = long[row] if row in long else int(payloads[row]).to_bytes(CLASSIC_BYTES, "little")[: int(lengths[row])]
            message = self.feed(float(time_s[row]), int(identifiers[row]), data)
            if message is not None:
                whole.append(message._replace(row=row))
        return whole


def numbers(data: Sequence[bytes], end: int) -> Numbers:
    """What a block's messages say. end: bytes that are wanted of each, of which it need not have so many."""
    width = end + CLASSIC_BYTES
    joined = b"".join(one[:width].ljust(width, b"\x00") for one in data)
    table = np.frombuffer(joined, np.uint8).reshape(len(data), width)

    def at(byte: int) -> NDArray[np.uint64]:
        found: NDArray[np.uint64] = np.ascontiguousarray(table[:, byte : byte + CLASSIC_BYTES]).view("<u8")[:, 0]
        return found

    return at


def number(data: bytes, byte: int) -> tuple[int, int]:
    """The eight bytes from `byte` on as a number, the first one lowest and the first one highest."""
    eight = data[byte : byte + CLASSIC_BYTES].ljust(CLASSIC_BYTES, b"\x00")
    return int.from_bytes(eight, "little"), int.from_bytes(eight, "big")
