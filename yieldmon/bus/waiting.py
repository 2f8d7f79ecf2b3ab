"""Receiving and sending with a time limit that no clock setting stretches.

python-can's own `recv(timeout)` and `send(timeout)` reckon with the system's time: a clock that is set back by an hour while the
bus is silent holds them for an hour.
"""

from __future__ import annotations

import select
from collections.abc import Callable, Iterator
from time import monotonic

import can

from yieldmon.bus.sockets import can_socket


def receive(bus: can.BusABC, timeout_s: float, passes: Callable[[can.Message], bool] | None = None) -> can.Message | None:
    """The next frame that passes the bus's filters, None when none came within timeout_s seconds of monotonic time.

    passes: the bus's filters, where the caller has a faster way to ask them. Raises what the bus's `recv` raises.
    """
    passes = passes or bus._matches_filters
    end_s = monotonic() + timeout_s
    left_s = timeout_s
    while True:
        message, filtered = _read(bus, max(0.0, left_s))
        if message is not None and (filtered or passes(message)):
            return message
        left_s = end_s - monotonic()
        if left_s <= 0.0:
            return None


def receive_kept(bus: can.BusABC, limit: int, passes: Callable[[can.Message], bool]) -> Iterator[can.Message]:
    """Frames that the kernel has kept for a bus until now and that pass its filters, after `limit` reads at most.

    Raises what the bus's `recv` raises.
    """
    for _ in range(limit):
        message, filtered = _read(bus, 0.0)
        if message is not None:
            if filtered or passes(message):
                yield message
        elif not select.select([bus.fileno()], [], [], 0)[0]:
            # Else it was one that the bus leaves out by itself.
            return


def _read(bus: can.BusABC, timeout_s: float) -> tuple[can.Message | None, bool]:
    """What one read brings, and whether it is filtered already."""
    if type(bus).recv is not can.BusABC.recv:
        return bus.recv(timeout_s), True
    return bus._recv_internal(timeout=timeout_s)


def send(bus: can.BusABC, message: can.Message, timeout_s: float | None) -> None:
    """Send a frame, waiting timeout_s seconds of monotonic time at most for room. Raises what the bus's `send` raises."""
    sock = can_socket(bus)
    if sock is None or timeout_s is None or sock.fileno() < 0:
        bus.send(message, timeout=timeout_s)
        return
    select.select([], [sock], [], timeout_s)
    bus.send(message, timeout=0)
