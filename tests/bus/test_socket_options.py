"""What is asked of a SocketCAN bus's socket, on a socket that says it is one. Real ones are in tests/vcan."""

from __future__ import annotations

import logging
import socket
import struct

import can
import pytest

from yieldmon.bus.opening import BusUnavailable, kept_by_the_kernel, kernel_drops_of, prepared, time_stamps_of
from yieldmon.bus.waiting import receive_kept, send

SO_RCVBUFFORCE, SO_MEMINFO = 33, 55
"""linux/socket.h."""


class CanSocket(socket.socket):
    """granted: bytes that the kernel gives; forced: whether it may be asked beyond its limit."""

    def __init__(self, granted: int = 4 * 1024 * 1024, forced: bool = True) -> None:
        ours, self.peer = socket.socketpair()
        super().__init__(fileno=ours.detach())
        self.granted, self.forced = granted, forced
        self.asked: list[tuple[int, int, int]] = []
        self.memory = struct.pack("9I", *range(100, 109))

    @property
    def family(self) -> int:
        return socket.AF_CAN

    def setsockopt(self, level: int, name: int, value: int) -> None:  # type: ignore[override]
        if name == SO_RCVBUFFORCE and not self.forced:
            raise PermissionError(1, "Operation not permitted")
        self.asked.append((level, name, value))

    def getsockopt(self, level: int, name: int, size: int = 0) -> int | bytes:  # type: ignore[override]
        if name == SO_MEMINFO:
            if not self.memory:
                raise OSError(92, "Protocol not available")
            return self.memory[:size]
        return self.granted


class SocketBus(can.BusABC):
    """A bus on such a socket, with frames that wait; an error in their place is raised."""

    def __init__(self, sock: CanSocket, frames: int = 0, error: Exception | None = None) -> None:
        super().__init__(channel="can0")
        self.channel_info = "can0"
        self.socket, self.left, self.error = sock, frames, error
        self.sent: list[float | None] = []
        self.ended = False

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.error is not None:
            raise self.error
        self.left -= 1
        return (can.Message(arbitration_id=self.left), False) if self.left >= 0 else (None, False)

    def fileno(self) -> int:
        return self.socket.fileno()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append(timeout)

    def shutdown(self) -> None:
        super().shutdown()
        self.ended = True
        self.socket.close()
        self.socket.peer.close()


@pytest.mark.parametrize(("forced", "option"), [(True, SO_RCVBUFFORCE), (False, socket.SO_RCVBUF)])
@pytest.mark.parametrize(("granted", "warned"), [(8191, True), (8192, False), (8193, False)])
def test_half_of_the_buffer_is_asked_for_since_the_kernel_doubles_it(
    forced: bool, option: int, granted: int, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    sock = CanSocket(granted, forced)
    with prepared(SocketBus(sock, 3), None, 8192) as bus:
        assert sock.asked == [(socket.SOL_SOCKET, option, 4096)]
        assert not sock.getblocking()
        assert bus.left == 3, "without filters nothing is dropped"
    words = f"receive buffer {granted} bytes, asked for 8192; raise net.core.rmem_max"
    assert (words in caplog.text) is warned
    assert f"can0: receive buffer {granted} bytes" in caplog.text


def test_four_mebibytes_are_asked_for() -> None:
    sock = CanSocket()
    prepared(SocketBus(sock), None).shutdown()
    assert sock.asked[0][2] == 2 * 1024 * 1024


@pytest.mark.parametrize(("queued", "left"), [(0, -1), (5, -1), (10_000, 0), (10_001, 1)])
def test_what_came_before_the_filters_is_dropped(queued: int, left: int) -> None:
    """A bus that brings frames faster than they are dropped does not hold up the start."""
    with prepared(SocketBus(CanSocket(), queued), []) as bus:
        assert bus.left == left


@pytest.mark.parametrize("error", [can.CanOperationError("Network is down"), OSError(100, "Network is down")])
def test_a_bus_that_fails_at_once_is_closed(error: Exception) -> None:
    bus = SocketBus(CanSocket(), 1, error)
    with pytest.raises(BusUnavailable, match=r"can0: .*Network is down"):
        prepared(bus, [])
    assert bus.ended


def test_drops_are_the_ninth_figure_of_the_sockets_memory() -> None:
    sock = CanSocket()
    bus = SocketBus(sock)
    assert kernel_drops_of(bus) == 108
    sock.memory = sock.memory[:32]
    assert kernel_drops_of(bus) is None, "an older kernel tells less"
    sock.memory = b""
    assert kernel_drops_of(bus) is None
    bus.shutdown()
    assert kernel_drops_of(bus) is None


def test_who_stamps_and_keeps_frames() -> None:
    bus = SocketBus(CanSocket())
    assert kept_by_the_kernel(bus)
    bus.shutdown()
    with can.Bus(interface="virtual", channel="options") as virtual:
        assert not kept_by_the_kernel(virtual)
    stamped = {name: time_stamps_of(name) for name in ("socketcan", "udp_multicast", "pcan")}
    assert stamped == {"socketcan": "kernel, on receipt", "udp_multicast": "kernel, on receipt", "pcan": "driver of pcan"}


@pytest.mark.parametrize(("timeout_s", "given_s"), [(None, None), (0.01, 0)])
def test_a_send_waits_for_room_before_it_sends(timeout_s: float | None, given_s: float | None) -> None:
    bus = SocketBus(CanSocket())
    send(bus, can.Message(), timeout_s)
    assert bus.sent == [given_s]
    bus.shutdown()
    send(bus, can.Message(), 0.5)
    assert bus.sent[1:] == [0.5], "a closed bus says so itself"


@pytest.mark.parametrize(("frames", "limit", "passing"), [(0, 10, 0), (3, 10, 2), (5, 2, 1), (5, 5, 3), (5, 0, 0)])
def test_frames_that_were_kept_are_read_up_to_a_limit(frames: int, limit: int, passing: int) -> None:
    bus = SocketBus(CanSocket(), frames)
    found = list(receive_kept(bus, limit, lambda message: message.arbitration_id % 2 == 0))
    assert len(found) == passing
    assert bus.left == max(frames - limit, -1)
    bus.shutdown()


def test_a_frame_that_the_bus_leaves_out_by_itself_does_not_end_the_reading() -> None:
    """It was read, and more waits in the socket."""
    sock = CanSocket()
    sock.peer.send(b"more")
    bus = SocketBus(sock, -1)
    assert list(receive_kept(bus, 4, lambda message: True)) == []
    assert bus.left == -5
    bus.shutdown()
