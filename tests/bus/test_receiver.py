"""The receive thread on fake buses that fail on cue, and on python-can's virtual bus."""

from __future__ import annotations

import errno
import queue
import socket
import threading
import time

import can
import pytest

from yieldmon.bus import receiver as receiving
from yieldmon.bus.opening import BusUnavailable
from yieldmon.bus.receiver import BusEvent, BusEventKind, Receiver, nap_s

WAIT_S = 10.0


class ScriptedBus(can.BusABC):
    """Gives what the test feeds it: messages, or exceptions that recv() raises."""

    def __init__(self, *script) -> None:
        super().__init__(channel="scripted")
        self.feed: queue.Queue = queue.Queue()
        self.closed = threading.Event()
        self.all_taken = threading.Event()
        self.sent: list[can.Message] = []
        for item in script:
            self.feed.put(item)

    def _recv_internal(self, timeout):
        if self.feed.empty():
            self.all_taken.set()
        try:
            item = self.feed.get(block=bool(timeout), timeout=timeout)
        except queue.Empty:
            return None, True
        if isinstance(item, BaseException):
            raise item
        return item, True

    def send(self, msg, timeout=None) -> None:
        self.sent.append(msg)

    def shutdown(self) -> None:
        super().shutdown()
        self.closed.set()


def opener(*outcomes):
    """An open_bus that gives the outcomes one after the other; exceptions are raised."""
    remaining = list(outcomes)

    def open_bus():
        outcome = remaining.pop(0)
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    return open_bus


def frame(number: int) -> can.Message:
    return can.Message(arbitration_id=number, timestamp=float(number), data=b"")


def error_frame(classes: int, data: bytes = bytes(8)) -> can.Message:
    return can.Message(arbitration_id=classes, is_error_frame=True, timestamp=7.0, data=data)


def collect(receiver: Receiver, count: int) -> list:
    """The next items in short: ids of frames, kinds of events."""
    items = []
    while len(items) < count:
        got = receiver.get_many(count - len(items), WAIT_S)
        assert got, f"only {items} came"
        items += got
    return [item.kind if isinstance(item, BusEvent) else item.arbitration_id for item in items]


DOWN = can.CanOperationError("Error receiving: Network is down", 100)


def test_frames_come_out_in_order() -> None:
    with Receiver(opener(ScriptedBus(*(frame(k) for k in range(100))))) as receiver:
        assert collect(receiver, 100) == list(range(100))
    assert receiver.counters().received == 100
    assert receiver.counters().dropped == 0


@pytest.mark.parametrize(
    ("received", "kind", "detail"),
    [
        (error_frame(0x040), BusEventKind.BUS_OFF, "bus off"),
        (error_frame(0x100), BusEventKind.BUS_RESTARTED, "controller restarted"),
        (error_frame(0x088), BusEventKind.BUS_ERROR, "protocol violation, bus error"),
        (error_frame(0x004, bytes([0, 0x01])), BusEventKind.FRAMES_DROPPED, "receive buffer overflow"),
        (error_frame(0x004, bytes([0, 0x20])), BusEventKind.BUS_ERROR, "transmit error passive"),
        (error_frame(0, b""), BusEventKind.BUS_ERROR, "bus error"),
    ],
)
def test_error_frames_become_events(received: can.Message, kind: BusEventKind, detail: str) -> None:
    with Receiver(opener(ScriptedBus(frame(1), received, frame(2)))) as receiver:
        first, event, second = (receiver.get(WAIT_S) for _ in range(3))
    assert (first.arbitration_id, second.arbitration_id) == (1, 2)
    assert (event.kind, event.time_s) == (kind, 7.0)
    assert detail in event.detail
    assert receiver.counters().error_frames == 1
    assert receiver.counters().bus_offs == (kind is BusEventKind.BUS_OFF)


def test_full_queue_drops_and_marks_the_place() -> None:
    bus = ScriptedBus(*(frame(k) for k in range(10)))
    receiver = Receiver(opener(bus), capacity=4, clock=lambda: 7.5)
    with receiver:
        assert bus.all_taken.wait(WAIT_S)
        assert collect(receiver, 4) == [0, 1, 2, 3]
        bus.feed.put(frame(10))
        marked, late = receiver.get(WAIT_S), receiver.get(WAIT_S)
    assert (marked.kind, marked.count, marked.time_s) == (BusEventKind.FRAMES_DROPPED, 6, 7.5)
    assert late.arbitration_id == 10
    assert receiver.counters().dropped == 6


def test_endless_error_frames_stay_bounded() -> None:
    """A broken bus and a consumer that has stopped: memory does not grow."""
    alternating = [error_frame(0x080), error_frame(0x008)]
    bus = ScriptedBus(*(alternating * 3000))
    with Receiver(opener(bus), capacity=10) as receiver:
        assert bus.all_taken.wait(WAIT_S)
        assert receiver.counters().error_frames == 6000
        assert len(receiver.get_many(10_000, 0)) <= 1010


def test_same_error_again_is_one_event_with_a_count() -> None:
    bus = ScriptedBus(*([error_frame(0x080)] * 500), frame(1))
    with Receiver(opener(bus)) as receiver:
        assert bus.all_taken.wait(WAIT_S)
        event, last = receiver.get(WAIT_S), receiver.get(WAIT_S)
    assert (event.kind, event.count) == (BusEventKind.BUS_ERROR, 500)
    assert last.arbitration_id == 1


@pytest.mark.parametrize("loss", [DOWN, OSError(19, "No such device"), ValueError("file descriptor cannot be -1")])
def test_interface_goes_and_comes_back(loss: Exception) -> None:
    """Absent, then present but down, then back: one loss and one restoration, and no frame out of order."""
    gone, down, back = ScriptedBus(frame(1), loss), ScriptedBus(DOWN), ScriptedBus(frame(2), frame(3))
    with Receiver(opener(gone, BusUnavailable("no such device"), down, back)) as receiver:
        assert collect(receiver, 5) == [1, BusEventKind.INTERFACE_LOST, BusEventKind.INTERFACE_RESTORED, 2, 3]
        assert receiver.bus is back
        assert gone.closed.is_set()
        assert down.closed.is_set()
    assert back.closed.is_set()
    assert receiver.counters().interface_losses == 1


def test_an_unexpected_error_is_reported_and_survived(caplog: pytest.LogCaptureFixture) -> None:
    with Receiver(opener(ScriptedBus(frame(1), ZeroDivisionError("boom")), ScriptedBus(frame(2))), clock=lambda: 7.5) as receiver:
        items = [receiver.get(WAIT_S) for _ in range(4)]
    events = [(item.kind, item.time_s) for item in items if isinstance(item, BusEvent)]
    assert events == [(BusEventKind.RECEIVER_FAILED, 7.5), (BusEventKind.INTERFACE_RESTORED, 7.5)]
    assert items[1].detail == "ZeroDivisionError: boom"
    assert items[3].arbitration_id == 2
    assert receiver.counters().failures == 1
    assert "ZeroDivisionError" in caplog.text


def test_a_bus_whose_first_read_fails_unexpectedly_is_closed() -> None:
    broken = ScriptedBus(ZeroDivisionError("boom"))
    with Receiver(opener(ScriptedBus(DOWN), broken, ScriptedBus(frame(2)))) as receiver:
        kinds = [BusEventKind.INTERFACE_LOST, BusEventKind.RECEIVER_FAILED, BusEventKind.INTERFACE_RESTORED, 2]
        assert collect(receiver, 4) == kinds
        assert broken.closed.is_set()


def test_missing_bus_at_the_start_is_raised() -> None:
    with pytest.raises(BusUnavailable, match="no such device"):
        Receiver(opener(BusUnavailable("no such device"))).start()


def test_stop_ends_a_wait_for_the_interface() -> None:
    receiver = Receiver(opener(ScriptedBus(DOWN), *[BusUnavailable("away")] * 1000))
    receiver.start()
    assert receiver.get(WAIT_S).kind is BusEventKind.INTERFACE_LOST
    receiver.stop()
    assert receiver.bus is None
    assert receiver.get(WAIT_S) is None


def test_send_while_away_is_a_can_error() -> None:
    receiver = Receiver(opener(ScriptedBus(DOWN), *[BusUnavailable("away")] * 1000))
    with receiver:
        assert receiver.get(WAIT_S).kind is BusEventKind.INTERFACE_LOST
        with pytest.raises(can.CanError, match="away"):
            receiver.send(frame(1))


def test_sends_on_the_bus_it_reads() -> None:
    bus = ScriptedBus()
    with Receiver(opener(bus)) as receiver:
        receiver.send(frame(5))
    assert [message.arbitration_id for message in bus.sent] == [5]


def test_stopped_receiver_still_gives_what_it_has() -> None:
    bus = ScriptedBus(frame(1))
    receiver = Receiver(opener(bus))
    receiver.start()
    assert bus.all_taken.wait(WAIT_S)
    receiver.stop()
    assert receiver.get(0).arbitration_id == 1
    assert receiver.get(0) is None


def test_a_receiver_starts_once() -> None:
    with Receiver(opener(ScriptedBus())) as receiver, pytest.raises(RuntimeError, match="once"):
        receiver.start()


class BusWhoseSenderIsTold(can.BusABC):
    """Receives nothing; sending fails as on an interface that has gone, of which the kernel tells a socket once."""

    def __init__(self) -> None:
        super().__init__(channel="gone")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("Failed to transmit: Network is down", errno.ENETDOWN)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        threading.Event().wait(min(timeout or 0.0, 0.01))
        return None, False


def test_interface_loss_that_only_sending_meets_is_seen():
    opened: list[can.BusABC] = []

    def open_bus() -> can.BusABC:
        opened.append(BusWhoseSenderIsTold())
        return opened[-1]

    with Receiver(open_bus) as receiver:
        with pytest.raises(can.CanError):
            receiver.send(can.Message(arbitration_id=1))
        events = [receiver.get(10.0), receiver.get(10.0)]
    assert [event.kind for event in events] == [BusEventKind.INTERFACE_LOST, BusEventKind.INTERFACE_RESTORED]
    assert "Network is down" in events[0].detail
    assert len(opened) == 2


class KernelsBus(can.BusABC):
    """Frames wait in a socket, as on SocketCAN; those with odd numbers are left out by filters in Python."""

    def __init__(self) -> None:
        super().__init__(channel="socket pair")
        self.ours, self.far_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)

    def arrive(self, *numbers: int) -> None:
        for number in numbers:
            self.far_end.send(bytes([number]))

    def fileno(self) -> int:
        return self.ours.fileno()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self.ours.settimeout(timeout or 1e-6)
        try:
            number = self.ours.recv(1)[0]
        except (TimeoutError, BlockingIOError):
            return None, False
        if number == 255:
            raise can.CanOperationError("Network is down", errno.ENETDOWN)
        return (frame(number) if number % 2 == 0 else None), True

    def shutdown(self) -> None:
        super().shutdown()
        self.ours.close()
        self.far_end.close()


@pytest.fixture
def in_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(receiving, "kept_by_the_kernel", lambda bus: isinstance(bus, KernelsBus))


@pytest.mark.usefixtures("in_batches")
def test_what_waits_is_fetched_together_in_order_and_up_to_a_loss() -> None:
    """Frames that the filters leave out are not taken for the end; what came before a loss is not lost."""
    bus = KernelsBus()
    bus.arrive(0, 2, 1, 3, 4, 6, 255)
    with Receiver(opener(bus, ScriptedBus(frame(8)))) as receiver:
        got = collect(receiver, 7)
    assert got == [0, 2, 4, 6, BusEventKind.INTERFACE_LOST, BusEventKind.INTERFACE_RESTORED, 8]


@pytest.mark.usefixtures("in_batches")
def test_the_consumer_is_woken_once_for_what_waits() -> None:
    bus = KernelsBus()
    bus.arrive(*range(0, 100, 2))
    with Receiver(opener(bus)) as receiver:
        assert [message.arbitration_id for message in receiver.get_many(100, WAIT_S)] == list(range(0, 100, 2))


@pytest.mark.parametrize(
    ("due_s", "rest_s"),
    [
        (float("-inf"), 0.0),
        (99.0, 0.0),
        (100.0, 0.0),
        (100.0015, 0.0),
        (100.011, pytest.approx(0.01)),
        (101.0, 0.03),
        (1e9, 0.03),
    ],
    ids=["nothing known", "overdue", "now", "at once", "soon", "later", "clock set back"],
)
def test_no_rest_outlasts_what_is_due(due_s: float, rest_s: float) -> None:
    assert nap_s(due_s, 100.0) == rest_s


def test_an_empty_queue_is_not_yet_a_silent_bus() -> None:
    """While the receiver has not come round to reading, nothing is known; once a read has found nothing, it is."""
    asked, let_go = threading.Event(), threading.Event()

    class Starved(ScriptedBus):
        def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
            if not self.feed.empty():
                return super()._recv_internal(timeout)
            asked.set()
            let_go.wait(WAIT_S)
            return None, True

    with Receiver(opener(Starved(frame(1)))) as receiver:
        assert asked.wait(WAIT_S)
        before = receiver.empty_until_s
        let_go.set()
        for _ in range(1000):
            if receiver.empty_until_s > before:
                break
            threading.Event().wait(0.01)
        assert before == float("-inf")
        assert receiver.empty_until_s > before


def test_what_the_kernel_dropped_on_a_bus_that_was_lost_stays_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    drops: dict[object, int] = {}
    monkeypatch.setattr(receiving, "kernel_drops_of", drops.get)
    first, second = ScriptedBus(), ScriptedBus()
    drops |= {first: 3, second: 4}
    with Receiver(opener(first, second)) as receiver:
        lost = receiver.get(WAIT_S)
        assert (lost.kind, lost.count) == (BusEventKind.FRAMES_DROPPED, 3)
        first.feed.put(OSError("gone"))
        found = [receiver.get(WAIT_S) for _ in range(3)]
    assert [(item.kind, item.count) for item in found[1:]] == [
        (BusEventKind.INTERFACE_RESTORED, 1),
        (BusEventKind.FRAMES_DROPPED, 4),
    ]
    assert receiver.counters().kernel_drops == 7


@pytest.mark.parametrize("dropped", [1, 2])
def test_one_frame_that_the_kernel_dropped_is_reported(monkeypatch: pytest.MonkeyPatch, dropped: int) -> None:
    bus = ScriptedBus()
    monkeypatch.setattr(receiving, "kernel_drops_of", {bus: dropped}.get)
    with Receiver(opener(bus)) as receiver:
        lost = receiver.get(WAIT_S)
        assert (lost.kind, lost.count) == (BusEventKind.FRAMES_DROPPED, dropped)


def test_a_consumer_that_waits_is_woken_once() -> None:
    with can.Bus(interface="virtual", channel="woken") as bus, Receiver(opener(bus)) as receiver:
        waiting = threading.Timer(0.05, receiver.wake)
        waiting.start()
        began_s = time.monotonic()
        assert receiver.get_many(10, WAIT_S) == []
        assert time.monotonic() - began_s < 0.5 * WAIT_S
        waiting.join()
        receiver.wake()
        assert receiver.get_many(10, WAIT_S) == [], "the next wait, where nobody waited"
        began_s = time.monotonic()
        assert receiver.get_many(10, 0.2) == []
        assert time.monotonic() - began_s > 0.15


def test_a_stop_waits_for_the_read_under_way() -> None:
    with can.Bus(interface="virtual", channel="listened") as bus:
        receiver = Receiver(opener(bus), listen_s=0.001)
        receiver.start()
        receiver.stop(WAIT_S)
        assert not receiver.alive
