"""Waiting on a bus while the system's clock is set."""

from __future__ import annotations

import itertools
import queue
import socket
import threading
import time

import can
import pytest

from yieldmon.bus.receiver import Receiver
from yieldmon.bus.waiting import receive, send

PATIENCE_S = 60.0


class ObedientBus(can.BusABC):
    """Silent unless given frames, and waits exactly as long as it is asked to."""

    def __init__(self) -> None:
        super().__init__(channel="obedient")
        self.frames: queue.SimpleQueue[can.Message] = queue.SimpleQueue()
        self.waits_s: list[float] = []

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.waits_s.append(-1.0 if timeout is None else timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        assert timeout is not None
        self.waits_s.append(timeout)
        try:
            return self.frames.get(timeout=min(timeout, PATIENCE_S)), False
        except queue.Empty:
            return None, False


@pytest.fixture
def clock_that_runs_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each look at the system's time finds it an hour earlier than the last."""
    hours = itertools.count()
    monkeypatch.setattr(time, "time", lambda: 1.8e9 - 3600.0 * next(hours))
    monkeypatch.setattr("can.bus.time", lambda: 1.8e9 - 3600.0 * next(hours))


def test_a_clock_that_is_set_back_delays_no_waiting_call(clock_that_runs_back):
    bus = ObedientBus()
    assert receive(bus, 0.05) is None
    assert max(bus.waits_s) <= 0.05
    bus.shutdown()


def test_frames_that_the_filters_leave_out_do_not_lengthen_the_wait(clock_that_runs_back):
    bus = ObedientBus()
    bus.set_filters([{"can_id": 1, "can_mask": 0x7FF, "extended": False}])
    for identifier in (5, 6, 1):
        bus.frames.put(can.Message(arbitration_id=identifier, is_extended_id=False))
    found = receive(bus, 0.05)
    assert found is not None
    assert found.arbitration_id == 1
    bus.shutdown()


def test_a_receiver_stops_though_the_clock_was_set_back_in_silence(clock_that_runs_back):
    bus = ObedientBus()
    receiver = Receiver(lambda: bus)
    receiver.start()
    stopped = threading.Thread(target=receiver.stop)
    stopped.start()
    stopped.join(PATIENCE_S)
    assert not stopped.is_alive()
    assert max(bus.waits_s) < 1.0


def test_sending_on_a_bus_of_another_kind_is_that_bus_own_affair():
    bus = ObedientBus()
    send(bus, can.Message(), 0.25)
    assert bus.waits_s == [0.25]
    bus.shutdown()


class BusWithSocket(ObedientBus):
    """One whose socket takes nothing any more, or anything."""

    def __init__(self, full: bool) -> None:
        super().__init__()
        self.socket, self.other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        while full:
            try:
                self.socket.send(bytes(1000))
            except BlockingIOError:
                break

    def fileno(self) -> int:
        return self.socket.fileno()


@pytest.mark.parametrize(("full", "timeout_s", "waited_s", "asked_s"), [
    (True, 0.1, 0.1, 0.0), (False, 5.0, 0.0, 0.0), (True, 0.0, 0.0, 0.0), (True, None, 0.0, -1.0),
])  # fmt: skip
def test_sending_waits_for_room_by_itself_and_asks_the_bus_for_no_waiting(
    monkeypatch: pytest.MonkeyPatch, full: bool, timeout_s: float | None, waited_s: float, asked_s: float
) -> None:
    bus = BusWithSocket(full)
    monkeypatch.setattr("yieldmon.bus.waiting.can_socket", lambda of: of.socket)
    begun_s = time.monotonic()
    send(bus, can.Message(), timeout_s)
    took_s = time.monotonic() - begun_s
    assert bus.waits_s == [asked_s]
    assert waited_s <= took_s < waited_s + 4.0
    bus.socket.close()
    bus.other.close()
    bus.shutdown()
