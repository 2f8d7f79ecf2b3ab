"""Receiving and sending with a time limit that no clock setting stretches.

python-can's own `recv(timeout)` and `send(timeout)` reckon with the system's time: a clock that is set back by an hour while the
bus is silent holds them for an hour.
"""

from __future__ import annotations

import select
from time import monotonic

import can

from yieldmon.bus.sockets import can_socket


def receive(bus: can.BusABC, timeout_s: float) -> can.Message | None:
    """The next frame that passes the bus's filters, None when none came within timeout_s seconds of monotonic time.

    Raises what the bus's `recv` raises.
    """
    if type(bus).recv is not can.BusABC.recv:
        return bus.recv(timeout_s)
    end_s = monotonic() + timeout_s
    left_s = timeout_s
    while True:
        message, filtered = bus._recv_internal(timeout=max(0.0, left_s))
        if message is not None and (filtered or bus._matches_filters(message)):
            return message
        left_s = end_s - monotonic()
        if left_s <= 0.0:
            return None


def send(bus: can.BusABC, message: can.Message, timeout_s: float | None) -> None:
    """Send a frame, waiting timeout_s seconds of monotonic time at most for room. Raises what the bus's `send` raises."""
    sock = can_socket(bus)
    if sock is None or timeout_s is None or sock.fileno() < 0:
        bus.send(message, timeout=timeout_s)
        return
    select.select([], [sock], [], timeout_s)
    bus.send(message, timeout=0)
