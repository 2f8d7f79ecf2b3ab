"""The transmit thread: order, age, a full queue, a bus that refuses, and our own echo."""

from __future__ import annotations

import threading

import can
import pytest

from yieldmon.service.transmit import Transmitter

PATIENCE_S = 60.0


class FakeBus:
    """Takes frames while `open` is set; refuses when told to."""

    def __init__(self) -> None:
        self.open = threading.Event()
        self.open.set()
        self.entered = threading.Semaphore(0)
        self.sent: list[int] = []
        self.refuse = False

    def send(self, message: can.Message, timeout_s: float | None) -> None:
        self.entered.release()
        assert self.open.wait(PATIENCE_S)
        if self.refuse:
            raise can.CanOperationError("Network is down")
        self.sent.append(message.arbitration_id)


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def bus() -> FakeBus:
    return FakeBus()


@pytest.fixture
def clock() -> Clock:
    return Clock()


def frame(number: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=number, data=data)


def test_frames_go_out_in_order(bus, clock):
    transmitter = Transmitter(bus.send, 10, 0.5, clock)
    transmitter.start()
    for number in range(5):
        transmitter.submit(frame(number))
    transmitter.stop()
    assert bus.sent == [0, 1, 2, 3, 4]
    assert transmitter.counters().sent == 5


def test_a_frame_that_waited_too_long_is_not_sent(bus, clock):
    transmitter = Transmitter(bus.send, 10, 0.5, clock)
    bus.open.clear()
    transmitter.start()
    transmitter.submit(frame(1))
    assert bus.entered.acquire(timeout=PATIENCE_S)
    transmitter.submit(frame(2))
    clock.now_s += 0.4
    transmitter.submit(frame(3))
    clock.now_s += 0.2
    bus.open.set()
    transmitter.stop()
    assert bus.sent == [1, 3]
    assert transmitter.counters().late == 1


def test_a_full_queue_loses_its_oldest(bus, clock):
    transmitter = Transmitter(bus.send, 3, 0.5, clock)
    for number in range(5):
        transmitter.submit(frame(number))
    transmitter.start()
    transmitter.stop()
    assert bus.sent == [2, 3, 4]
    assert transmitter.counters().late == 2


def test_a_bus_that_refuses_is_a_failure_for_two_seconds(bus, clock):
    bus.refuse = True
    transmitter = Transmitter(bus.send, 3, 0.5, clock)
    transmitter.submit(frame(1))
    transmitter.start()
    transmitter.stop()
    counters = transmitter.counters()
    assert (counters.failed, counters.last_failure) == (1, "Network is down")
    assert counters.failing(clock.now_s + 1.9)
    assert not counters.failing(clock.now_s + 2.1)


def test_an_echo_counts_once_and_not_for_ever(bus, clock):
    transmitter = Transmitter(bus.send, 3, 0.5, clock)
    transmitter.submit(frame(7, b"ab"))
    transmitter.start()
    transmitter.stop()
    assert not transmitter.is_echo(frame(7, b"ac"))
    assert transmitter.is_echo(frame(7, b"ab"))
    assert not transmitter.is_echo(frame(7, b"ab")), "a second copy is another node's"
    transmitter = Transmitter(bus.send, 3, 0.5, clock)
    transmitter.submit(frame(7, b"ab"))
    transmitter.start()
    transmitter.stop()
    clock.now_s += 1.1
    assert not transmitter.is_echo(frame(7, b"ab"))


def test_who_asks_waits_until_all_that_waited_is_on_the_bus(bus, clock):
    transmitter = Transmitter(bus.send, 10, 0.5, clock)
    assert transmitter.wait_until_sent(0.0), "nothing waits"
    transmitter.submit(frame(1), frame(2))
    bus.open.clear()
    transmitter.start()
    assert bus.entered.acquire(timeout=PATIENCE_S)
    assert not transmitter.wait_until_sent(0.01), "the bus takes nothing"
    bus.open.set()
    assert transmitter.wait_until_sent(PATIENCE_S)
    assert bus.sent == [1, 2]
    transmitter.stop()
