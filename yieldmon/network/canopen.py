"""CANopen (CiA 301) as far as it tells why a node sends no values: states that nodes report, and predefined identifiers."""

from __future__ import annotations

_HEARTBEAT, _MOST_NODES = 0x700, 0x7F
_PROCESS_DATA = range(0x180, 0x580)
_STOPPED, _PRE_OPERATIONAL = 0x04, 0x7F
STATES = {0x00: "starts up", _STOPPED: "is stopped", 0x05: "is operational", _PRE_OPERATIONAL: "waits to be started"}
"""By the byte of a heartbeat."""


def node_of_heartbeat(identifier: int, length: int) -> int | None:
    """The node whose state an 11-bit frame of so many bytes may report."""
    node = identifier - _HEARTBEAT
    return node if 1 <= node <= _MOST_NODES and length == 1 else None


def node_of_values(identifier: int) -> int | None:
    """The node that by the predefined connections sends or takes values under an 11-bit identifier."""
    return identifier & _MOST_NODES or None if identifier in _PROCESS_DATA else None


def sends_values(state: int) -> bool:
    """Whether a node in this state sends its values."""
    return state not in (_STOPPED, _PRE_OPERATIONAL)


def how_to_start(node: int) -> str:
    """What starts a node."""
    return f"`cansend can0 000#01{node:02X}`, or its maker's setting to start itself"
