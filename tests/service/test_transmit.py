"""The transmit thread: order, age, a full queue, a bus that refuses, and our own echo."""

from __future__ import annotations

import threading

import can
import pytest

from yieldmon.service.traffic.echoes import ASKED_ECHO_S
from yieldmon.service.traffic.transmit import Transmitter

PATIENCE_S = 60.0


class FakeBus:
    """Takes frames while `open` is set; refuses when asked to."""

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
    assert not transmitter.echoes.is_echo(frame(7, b"ac"))
    assert transmitter.echoes.is_echo(frame(7, b"ab"))
    assert not transmitter.echoes.is_echo(frame(7, b"ab")), "a second copy is another node's"
    transmitter = Transmitter(bus.send, 3, 0.5, clock)
    transmitter.submit(frame(7, b"ab"))
    transmitter.start()
    transmitter.stop()
    clock.now_s += 1.1
    assert not transmitter.echoes.is_echo(frame(7, b"ab"))


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


BEYOND_S = 1.0 / 1024.0


def transmitted(transmitter: Transmitter, *messages: can.Message) -> None:
    transmitter.submit(*messages)
    assert transmitter.wait_until_sent(PATIENCE_S)


@pytest.fixture
def started(bus, clock):
    """A transmitter whose frames may wait half a second and come back within one."""
    transmitter = Transmitter(bus.send, 4, 0.5, clock, 1.0)
    transmitter.start()
    yield transmitter
    bus.open.set()
    assert transmitter.stop(PATIENCE_S)
    assert not transmitter.alive


@pytest.mark.parametrize(("waited_s", "sent"), [(0.5, [1, 2]), (0.5 + BEYOND_S, [1])])
def test_a_frame_may_wait_so_long(bus, clock, started, waited_s, sent):
    bus.open.clear()
    started.submit(frame(1))
    assert bus.entered.acquire(timeout=PATIENCE_S)
    started.submit(frame(2))
    assert (started.waiting, started.hangs_s(), started.alive) == (1, 0.0, True)
    clock.now_s += waited_s
    assert started.hangs_s() == waited_s
    bus.open.set()
    assert started.wait_until_sent(PATIENCE_S)
    assert (bus.sent, started.hangs_s(), started.waiting) == (sent, 0.0, 0)
    assert started.counters().late_now(clock.now_s + 2.0 - BEYOND_S) is (sent == [1])
    assert not started.counters().late_now(clock.now_s + 2.0)


def test_a_refused_frame_is_reported_for_two_seconds_with_its_reason_and_is_no_echo(bus, clock, started):
    assert not started.counters().failing(0.0)
    bus.refuse = True
    transmitted(started, frame(1))
    counters = started.counters()
    assert (counters.failed, counters.sent, counters.late, counters.last_failure) == (1, 0, 0, "Network is down")
    assert counters.failing(clock.now_s + 2.0 - BEYOND_S)
    assert not counters.failing(clock.now_s + 2.0)
    assert not started.echoes.is_echo(frame(1))
    bus.refuse = False
    clock.now_s += 1.0
    transmitted(started, frame(2))
    counters = started.counters()
    assert (counters.sent, counters.last_failure, counters.last_failure_at_s) == (1, "Network is down", 100.0)


@pytest.mark.parametrize(("later_s", "is_ours"), [(0.0, True), (1.0, True), (1.0 + BEYOND_S, False)])
def test_an_echo_comes_within_its_time(clock, started, later_s, is_ours):
    transmitted(started, frame(7, b"ab"))
    clock.now_s += later_s
    assert started.echoes.is_echo(frame(7, b"ab")) is is_ours


@pytest.mark.parametrize(("silent", "seen_before", "is_ours"), [(19, False, True), (20, False, False), (20, True, True)])
def test_an_interface_that_has_shown_none_of_the_first_frames_shows_none(clock, started, silent, seen_before, is_ours):
    """Then a copy of ours is another node's; one that has shown one shows all."""
    if seen_before:
        transmitted(started, frame(1))
        assert started.echoes.is_echo(frame(1))
    for number in range(silent):
        transmitted(started, frame(number))
        clock.now_s += 2.0
    transmitted(started, frame(99))
    assert started.echoes.is_echo(frame(99)) is is_ours


def test_an_interface_that_was_asked_to_show_frames_is_relied_on(bus, clock):
    transmitter = Transmitter(bus.send, 4, 0.5, clock, ASKED_ECHO_S)
    transmitter.start()
    for number in range(25):
        transmitted(transmitter, frame(number))
        clock.now_s += 11.0
    transmitted(transmitter, frame(99))
    clock.now_s += 10.0
    assert transmitter.echoes.is_echo(frame(99))
    assert transmitter.stop(PATIENCE_S)


@pytest.mark.parametrize(("count", "late"), [(4, 0), (5, 1), (9, 5)])
def test_so_many_frames_wait(bus, clock, count, late):
    transmitter = Transmitter(bus.send, 4, 0.5, clock)
    transmitter.submit()
    transmitter.submit(*map(frame, range(count)))
    assert (transmitter.waiting, transmitter.counters().late, transmitter.alive) == (4, late, False)
    assert transmitter.counters().late_now(clock.now_s) is (late > 0)
    transmitter.start()
    assert transmitter.stop(PATIENCE_S)
    assert bus.sent == list(range(count))[-4:]


def test_a_refused_frame_whose_copy_was_heard_costs_no_other_its_echo(clock) -> None:
    def send(message: can.Message, timeout_s: float | None) -> None:
        if message.arbitration_id == 2:
            assert transmitter.echoes.is_echo(frame(2))
            raise can.CanOperationError("No buffer space available")

    transmitter = Transmitter(send, 10, 0.5, clock)
    transmitter.start()
    transmitter.submit(frame(1), frame(2))
    assert transmitter.stop()
    assert transmitter.echoes.is_echo(frame(1))


@pytest.mark.parametrize("paused_s", [0.6, 1.5, 30.0])
@pytest.mark.parametrize("echo_s", [1.0, ASKED_ECHO_S])
def test_an_echo_that_is_read_late_because_the_process_stood_still_is_ours(bus, clock, paused_s: float, echo_s: float) -> None:
    """What is sent while nothing is read (SIGSTOP, no processor) comes back all the same, once."""
    transmitter = Transmitter(bus.send, 10, 60.0, clock, echo_s)
    transmitter.start()
    transmitter.echoes.look()
    transmitted(transmitter, frame(1))
    clock.now_s += paused_s
    transmitted(transmitter, frame(2))
    transmitter.echoes.look()
    assert [transmitter.echoes.is_echo(frame(number)) for number in (1, 2, 1, 2)] == [True, True, False, False]
    assert transmitter.stop(PATIENCE_S)


@pytest.mark.parametrize("echo_s", [1.0, ASKED_ECHO_S])
def test_a_copy_that_comes_too_late_while_all_is_read_is_another_nodes(bus, clock, echo_s: float) -> None:
    transmitter = Transmitter(bus.send, 10, 60.0, clock, echo_s)
    transmitter.start()
    transmitted(transmitter, frame(1))
    for _ in range(int(echo_s / 0.25) + 1):
        clock.now_s += 0.25
        transmitter.echoes.look()
    assert not transmitter.echoes.is_echo(frame(1))
    assert transmitter.stop(PATIENCE_S)
