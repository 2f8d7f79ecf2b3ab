"""What SocketCAN's error frames say: the error classes and controller states of linux/can/error.h."""

from __future__ import annotations

from enum import Enum

import can

_TX_TIMEOUT = 0x001
_LOST_ARBITRATION = 0x002
_CONTROLLER = 0x004
_PROTOCOL = 0x008
_TRANSCEIVER = 0x010
_NO_ACK = 0x020
_BUS_OFF = 0x040
_BUS_ERROR = 0x080
_RESTARTED = 0x100

_CLASSES = {
    _TX_TIMEOUT: "transmit timeout",
    _LOST_ARBITRATION: "lost arbitration",
    _CONTROLLER: "controller problem",
    _PROTOCOL: "protocol violation",
    _TRANSCEIVER: "transceiver problem",
    _NO_ACK: "no acknowledge",
    _BUS_OFF: "bus off",
    _BUS_ERROR: "bus error",
    _RESTARTED: "controller restarted",
}

#: Bits of data byte 1 of a controller problem.
_CONTROLLER_STATES = {
    0x01: "receive buffer overflow",
    0x02: "transmit buffer overflow",
    0x04: "receive error warning",
    0x08: "transmit error warning",
    0x10: "receive error passive",
    0x20: "transmit error passive",
    0x40: "error active again",
}


class ErrorKind(Enum):
    """What an error frame means to a receiver."""

    BUS_ERROR = "bus error"
    BUS_OFF = "bus off"
    RESTARTED = "restarted"
    OVERFLOW = "controller overflow"
    """The controller itself lost received frames."""


def kind_of(message: can.Message) -> ErrorKind:
    """Kind of an error frame; a frame whose class an interface does not name counts as BUS_ERROR."""
    classes = message.arbitration_id
    if classes & _BUS_OFF:
        return ErrorKind.BUS_OFF
    if classes & _RESTARTED:
        return ErrorKind.RESTARTED
    if classes & _CONTROLLER and _controller_state(message) & 0x01:
        return ErrorKind.OVERFLOW
    return ErrorKind.BUS_ERROR


def describe(message: can.Message) -> str:
    """One line that names every error class and controller state in the frame."""
    words = [name for bit, name in _CLASSES.items() if message.arbitration_id & bit]
    if message.arbitration_id & _CONTROLLER:
        state = _controller_state(message)
        words += [name for bit, name in _CONTROLLER_STATES.items() if state & bit]
    return ", ".join(words) or "bus error"


def _controller_state(message: can.Message) -> int:
    return message.data[1] if len(message.data) > 1 else 0
