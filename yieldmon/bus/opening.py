"""Opening a CAN bus through python-can, and what SocketCAN needs beside it: kernel filters and a receive buffer."""

from __future__ import annotations

import argparse
import logging
import socket
import struct
from collections.abc import Sequence
from typing import Any

import can
from can.cli import add_bus_arguments as add_python_can_arguments
from can.cli import create_bus_from_namespace
from can.typechecking import CanFilter

from yieldmon.bus.sockets import can_socket
from yieldmon.bus.waiting import receive
from yieldmon.errors import InputError, reason

_log = logging.getLogger(__name__)

#: Asked for on SocketCAN. A queued frame takes about 700 bytes there: some 6,000 frames, over 3 s of a full 250 kbit/s
#: bus.
RECEIVE_BUFFER_BYTES = 4 * 1024 * 1024

# linux/socket.h; the socket module does not name them.
_SO_RCVBUFFORCE = 33
_SO_MEMINFO = 55
_SK_MEMINFO_DROPS = 8
_MEMINFO = struct.Struct("9I")


class BusUnavailable(can.CanError):
    """A bus that is configured rightly, as far as can be known, and cannot be opened now."""


def open_bus(
    interface: str,
    channel: str | int | None,
    bitrate: int | None = None,
    *,
    filters: Sequence[CanFilter] | None = None,
    receive_own: bool = False,
    receive_buffer_bytes: int = RECEIVE_BUFFER_BYTES,
    **options: Any,
) -> can.BusABC:
    """Opens any python-can bus; `options` go to its constructor as they are.

    bitrate: bit/s; SocketCAN ignores it (`ip link` or systemd-networkd sets it). filters: as Codec.filters() makes
    them; error frames pass all the same. receive_own: also deliver what this bus object sends. receive_buffer_bytes:
    receive buffer asked for on SocketCAN; what the kernel grants is in the log.

    Raises InputError for an interface that python-can does not know or options that it refuses, and BusUnavailable when
    the device is absent, down or not permitted.
    """
    if interface not in can.VALID_INTERFACES:
        raise InputError("interface", repr(interface), f"one of {', '.join(sorted(can.VALID_INTERFACES))}")
    if bitrate is not None:
        options["bitrate"] = bitrate
    where = f"{interface} channel {channel}"
    try:
        bus = can.Bus(
            interface=interface,
            channel=channel,
            can_filters=list(filters) if filters is not None else None,
            receive_own_messages=receive_own,
            **options,
        )
    except (can.CanError, OSError, ImportError) as error:
        raise BusUnavailable(f"{where}: {reason(error)}") from error
    except (ValueError, TypeError) as error:
        raise InputError(where, str(error), "options that this python-can interface accepts") from error
    return prepared(bus, filters, receive_buffer_bytes)


def prepared(
    bus: can.BusABC, filters: Sequence[CanFilter] | None, receive_buffer_bytes: int = RECEIVE_BUFFER_BYTES
) -> can.BusABC:
    """The same bus with its receive buffer enlarged, and rid of frames queued before the filters were set."""
    sock = can_socket(bus)
    if sock is not None:
        # The kernel reports a lost interface once: between select() and recv() a sending thread may take that away, and
        # a blocking recv() would then wait for ever.
        sock.setblocking(False)
        _log.info("%s: receive buffer %d bytes", bus.channel_info, _enlarge_receive_buffer(sock, receive_buffer_bytes))
        if filters is not None:
            _drain(bus)
    return bus


def add_bus_arguments(parser: argparse.ArgumentParser) -> None:
    """The bus options of python-can's own tools: -i, -c, -b, --fd, --bus-kwargs and so on."""
    add_python_can_arguments(parser)
    for action in parser._actions:
        if action.dest == "interface":
            # Without it the two dozen names stand three times in the help, on lines of 300 columns.
            action.metavar = "INTERFACE"
            action.help = f"{action.help} One of {', '.join(sorted(can.VALID_INTERFACES))}."


def open_bus_from(args: argparse.Namespace, *, filters: Sequence[CanFilter] | None = None) -> can.BusABC:
    """Opens the bus that add_bus_arguments()'s options name; what they leave out comes from python-can's configuration.

    Raises InputError when no interface is named anywhere or its options are refused, BusUnavailable when it cannot be
    opened.
    """
    keywords: dict[str, Any] = {"receive_own_messages": False}
    if filters is not None:
        keywords["can_filters"] = list(filters)
    try:
        bus = create_bus_from_namespace(args, **keywords)
    except argparse.ArgumentError as error:
        cause = error.__cause__
        if isinstance(cause, can.CanInterfaceNotImplementedError) and "interface" not in args:
            raise InputError(
                "bus", "no CAN interface named", "-i INTERFACE -c CHANNEL as python-can's tools take them"
            ) from error
        where = f"{getattr(args, 'interface', 'bus')} channel {getattr(args, 'channel', None)}"
        if isinstance(cause, can.CanError | OSError | ImportError):
            raise BusUnavailable(f"{where}: {reason(cause)}") from error
        raise InputError(where, str(cause), "options that this python-can interface accepts") from error
    return prepared(bus, filters)


def kernel_drops_of(bus: can.BusABC) -> int | None:
    """Frames that the kernel dropped because a SocketCAN bus was not read in time, since it was opened; None
    elsewhere."""
    sock = can_socket(bus)
    if sock is None or sock.fileno() < 0:
        return None
    try:
        memory = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
    except OSError:
        return None
    return int(_MEMINFO.unpack(memory)[_SK_MEMINFO_DROPS]) if len(memory) == _MEMINFO.size else None


#: python-can reads the kernel's software receive times (SO_TIMESTAMPNS) on these, and asks no driver for hardware times.
_KERNEL_STAMPED = frozenset({"socketcan", "udp_multicast"})


def time_stamps_of(interface: str) -> str:
    """Who stamps the frames of a python-can interface, for people: the kernel as the driver hands them over, or the interface's
    own driver, whose clock may be the adapter's or this program's."""
    return "kernel, on receipt" if interface in _KERNEL_STAMPED else f"driver of {interface}"


def kept_by_the_kernel(bus: can.BusABC) -> bool:
    """Whether the kernel stamps and keeps this bus's frames, by the system's clock, so that one read later is as good."""
    return can_socket(bus) is not None or type(bus).__name__ == "UdpMulticastBus"


def _enlarge_receive_buffer(sock: socket.socket, wanted_bytes: int) -> int:
    """Bytes granted. Force is for CAP_NET_ADMIN; without it the kernel caps the request at net.core.rmem_max."""
    # The kernel doubles what it is asked for, to pay for its bookkeeping.
    half = wanted_bytes // 2
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, half)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, half)
    granted = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if granted < wanted_bytes:
        _log.warning("receive buffer %d bytes, asked for %d; raise net.core.rmem_max", granted, wanted_bytes)
    return granted


def _drain(bus: can.BusABC) -> None:
    """Drops the frames that arrived between the socket's binding and its filters. A frame too many costs one gap."""
    queued_at_most = 10_000
    try:
        for _ in range(queued_at_most):
            if receive(bus, 0.0) is None:
                return
    except (can.CanError, OSError) as error:
        bus.shutdown()
        raise BusUnavailable(f"{bus.channel_info}: {error}") from error
