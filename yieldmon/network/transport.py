"""What both sides of SAE J1939-21's transport protocol say to each other."""

from __future__ import annotations

from .identifier import TRANSPORT_CONNECTION, RawFrame, frame, group_bytes

RTS, CTS, END_OF_MESSAGE, BROADCAST, ABORT = 16, 17, 19, 32, 255
"""Control bytes."""
BUSY, NO_RESOURCES, TIMED_OUT, BAD_SEQUENCE = 1, 2, 3, 7
"""Reasons of an abort."""
PRIORITY = 7


def control(group: int, head: bytes, source: int, destination: int) -> RawFrame:
    """A frame of connection management: control byte and what belongs to it, then the group that it is about."""
    return frame(TRANSPORT_CONNECTION, head.ljust(5, b"\xff") + group_bytes(group), source, destination, PRIORITY)


def abort(group: int, reason: int, source: int, destination: int) -> RawFrame:
    """The frame that ends a session early."""
    return control(group, bytes([ABORT, reason]), source, destination)
