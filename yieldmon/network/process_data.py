"""Process data messages of ISO 11783-10 (PGN 51968): commands, element number, DDI and value in eight bytes."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

PROCESS_DATA = 51968
WORKING_SET_MASTER = 65037

LEAST, MOST = -(2**31), 2**31 - 1
"""Values that a message can carry."""
_VALUE = struct.Struct("<i")


class Command(IntEnum):
    """Lower four bits of the first byte, ISO 11783-10 table B.1."""

    TECHNICAL = 0
    DEVICE_DESCRIPTOR = 1
    REQUEST_VALUE = 2
    VALUE = 3
    TIME_INTERVAL = 4
    DISTANCE_INTERVAL = 5
    MINIMUM_WITHIN_THRESHOLD = 6
    MAXIMUM_WITHIN_THRESHOLD = 7
    CHANGE_THRESHOLD = 8
    PEER_CONTROL = 9
    SET_AND_ACKNOWLEDGE = 10
    ACKNOWLEDGE = 13
    SERVER_STATUS = 14
    CLIENT_TASK = 15


class Refusal(IntEnum):
    """Bits of an acknowledgement's error byte."""

    NONE = 0
    COMMAND_NOT_SUPPORTED = 1
    NO_SUCH_ELEMENT = 2
    NO_SUCH_DDI = 4
    NO_SUCH_TRIGGER = 8
    NOT_SETTABLE = 16
    BAD_INTERVAL = 32


@dataclass(frozen=True, slots=True)
class ProcessData:
    """One process data variable: a command, the element and DDI that it is about, and the raw value, signed 32 bits."""

    command: Command
    element: int
    ddi: int
    value: int

    @property
    def data(self) -> bytes:
        """The eight bytes."""
        head = bytes([self.command | (self.element & 0xF) << 4, self.element >> 4 & 0xFF])
        return head + self.ddi.to_bytes(2, "little") + _VALUE.pack(self.value)


_WITH_VARIABLE = frozenset(range(Command.REQUEST_VALUE, Command.CHANGE_THRESHOLD + 1)) | {Command.SET_AND_ACKNOWLEDGE}


def read(data: bytes) -> ProcessData | None:
    """The variable in a message; None for the commands that are about none, and for damaged ones."""
    if len(data) != 8 or data[0] & 0xF not in _WITH_VARIABLE:
        return None
    element = data[0] >> 4 | data[1] << 4
    return ProcessData(Command(data[0] & 0xF), element, int.from_bytes(data[2:4], "little"), _VALUE.unpack(data[4:])[0])


def acknowledge(about: ProcessData, refusal: Refusal) -> bytes:
    """The acknowledgement of a command, with the command that it is about in its sixth byte."""
    head = bytes([Command.ACKNOWLEDGE | (about.element & 0xF) << 4, about.element >> 4 & 0xFF])
    return head + about.ddi.to_bytes(2, "little") + bytes([refusal, about.command, 0xFF, 0xFF])
