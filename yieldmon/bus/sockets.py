"""The kernel's socket behind a python-can bus."""

from __future__ import annotations

import socket

import can


def can_socket(bus: can.BusABC) -> socket.socket | None:
    """The socket of a SocketCAN bus, None for any other."""
    sock = getattr(bus, "socket", None)
    family = getattr(socket, "AF_CAN", None)
    return sock if isinstance(sock, socket.socket) and family is not None and sock.family == family else None
