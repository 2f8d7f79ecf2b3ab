"""Requests for parameter groups and their acknowledgement: SAE J1939-21, 5.4.2 to 5.4.4."""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.identifiers import GLOBAL_ADDRESS

from .identifier import ACKNOWLEDGEMENT, REQUEST, Identifier, RawFrame, frame, group_bytes

POSITIVE, NEGATIVE, ACCESS_DENIED, CANNOT_RESPOND = 0, 1, 2, 3


@dataclass(frozen=True, slots=True)
class Request:
    """Somebody asks for a parameter group. directed: of one node, not of all."""

    group: int
    requester: int
    directed: bool


def request_in(parts: Identifier, data: bytes, our_address: int | None) -> Request | None:
    """The request in a frame, where it is for us: directed to our address, or global."""
    if parts.group != REQUEST or len(data) < 3:
        return None
    directed = parts.destination != GLOBAL_ADDRESS
    if directed and (our_address is None or parts.destination != our_address):
        return None
    return Request(int.from_bytes(data[:3], "little"), parts.source, directed)


def acknowledgement(request: Request, control: int, our_address: int) -> RawFrame:
    """The frame that grants or refuses a request; to all, with the address that it is for in its fifth byte."""
    data = bytes([control, 0xFF, 0xFF, 0xFF, request.requester]) + group_bytes(request.group)
    return frame(ACKNOWLEDGEMENT, data, our_address, GLOBAL_ADDRESS)


def request_frame(group: int, our_address: int, destination: int = GLOBAL_ADDRESS) -> RawFrame:
    """The frame that asks for a parameter group."""
    return frame(REQUEST, group_bytes(group), our_address, destination)
