"""CAN identifiers, and the parts that SAE J1939-21 gives those of 29 bits: priority, parameter group, source address."""

from __future__ import annotations

LARGEST_STANDARD_ID = 0x7FF
LARGEST_EXTENDED_ID = 0x1FFFFFFF
EXTENDED_FLAG = 0x80000000
"""Marks a 29-bit identifier, as SocketCAN does."""

CLASSIC_BYTES = 8
"""Of data in a classic frame, at most."""
FD_BYTES = 64
"""Of data in a CAN FD frame, at most."""
FD_LENGTHS: tuple[int, ...] = (*range(CLASSIC_BYTES + 1), 12, 16, 20, 24, 32, 48, FD_BYTES)
"""Bytes of data that a CAN FD frame may have, by its data length code."""

#: What distinguishes a J1939 message: all but the priority.
IDENTITY_MASK = 0x03FFFFFF
#: The same from any sender.
GROUP_MASK = 0x03FFFF00
#: The same whoever it is for: data pages and PDU format.
FORMAT_MASK = 0x03FF0000
DESTINATION_MASK = 0x0000FF00
SOURCE_MASK = 0x000000FF

GLOBAL_ADDRESS = 255
NULL_ADDRESS = 254
#: Address claims, which are for all; compared under GROUP_MASK.
ADDRESS_CLAIM = 0x00EEFF00
#: PDU formats from here on are broadcasts, whose PDU specific byte belongs to the group.
_FIRST_BROADCAST_FORMAT = 240


def is_broadcast(group: int) -> bool:
    """Whether a parameter group has no destination address (PDU 2)."""
    return group >> 8 & 0xFF >= _FIRST_BROADCAST_FORMAT


def group_of(identifier: int) -> int:
    """Parameter group number of a 29-bit identifier; the destination of a destination-specific group is no part of it."""
    group = identifier >> 8 & 0x3FFFF
    return group if is_broadcast(group) else group & 0x3FF00
