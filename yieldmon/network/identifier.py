"""29-bit identifiers of SAE J1939-21, and frames and complete parameter groups as they pass through this package."""

from __future__ import annotations

from typing import NamedTuple

from yieldmon.identifiers import GLOBAL_ADDRESS, NULL_ADDRESS, is_broadcast

#: Addresses below this one can be held by a node.
FIRST_UNUSABLE_ADDRESS = NULL_ADDRESS
DEFAULT_PRIORITY = 6

REQUEST = 59904
ACKNOWLEDGEMENT = 59392
ADDRESS_CLAIMED = 60928
COMMANDED_ADDRESS = 65240
TRANSPORT_CONNECTION = 60416
TRANSPORT_DATA = 60160


class Identifier(NamedTuple):
    """What a 29-bit identifier says.

    Attributes
    ----------
    priority : int
        0 (first) to 7.
    group : int
        Parameter group number, 18 bits.
    destination : int
        Address, 255 where the group is a broadcast.
    source : int
        Address of the sender.

    References
    ----------
    SAE J1939-21, 5.2.
    """

    priority: int
    group: int
    destination: int
    source: int

    @classmethod
    def of(cls, value: int) -> Identifier:
        """The parts of a 29-bit identifier; higher bits are ignored."""
        group, specific = value >> 8 & 0x3FF00, value >> 8 & 0xFF
        if is_broadcast(group):
            return cls(value >> 26 & 7, group | specific, GLOBAL_ADDRESS, value & 0xFF)
        return cls(value >> 26 & 7, group, specific, value & 0xFF)

    @property
    def value(self) -> int:
        """The 29-bit identifier."""
        specific = self.group & 0xFF if is_broadcast(self.group) else self.destination
        return self.priority << 26 | (self.group & 0x3FF00) << 8 | specific << 8 | self.source


class RawFrame(NamedTuple):
    """A frame to send: 29-bit identifier and up to eight bytes."""

    identifier: int
    data: bytes


class Payload(NamedTuple):
    """A complete parameter group, out of one frame or of several.

    time_s is when its last part came, in the receiver's own time.
    """

    time_s: float
    group: int
    source: int
    destination: int
    priority: int
    data: bytes


def frame(group: int, data: bytes, source: int, destination: int = GLOBAL_ADDRESS, priority: int = DEFAULT_PRIORITY) -> RawFrame:
    """A frame of one parameter group, of eight bytes at most. Raises ValueError for more."""
    if len(data) > 8:
        raise ValueError(f"{len(data)} bytes in one frame, expected at most 8")
    return RawFrame(Identifier(priority, group, destination, source).value, bytes(data))


def group_bytes(group: int) -> bytes:
    """A parameter group number as requests and transport frames carry it: three bytes, lowest first."""
    return group.to_bytes(3, "little")
