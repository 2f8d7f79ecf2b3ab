"""Replay on a clock that the test owns: due times, selection, loops, full transmit queues."""

from __future__ import annotations

import errno
import math

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.bus.filtering import FilterTable
from yieldmon.bus.replay import Progress, Schedule, Selection, Sender, replay
from yieldmon.frames import Frame

CODEC = Codec()
SPEED = CODEC.encode(Frame(0.0, frames.ELEVATOR_SPEED, {"ElevatorSpeed": 400.0}))


class FakeClock:
    """Time passes only in sleep(), and by `cost_s` in every send()."""

    def __init__(self, cost_s: float = 0.0) -> None:
        self.now_s = 1000.0
        self.cost_s = cost_s
        self.sent: list[tuple[float, int]] = []

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        assert duration_s > 0
        self.now_s += duration_s

    def send(self, message: can.Message) -> None:
        self.sent.append((self.now_s - 1000.0, message.arbitration_id))
        self.now_s += self.cost_s


def log(*times_s: float) -> list[can.Message]:
    return [can.Message(timestamp=time_s, arbitration_id=k) for k, time_s in enumerate(times_s)]


def run(passes, schedule: Schedule, clock: FakeClock) -> Progress:
    progress = Progress()
    replay(passes, clock.send, schedule, progress, clock=clock, sleep=clock.sleep)
    return progress


@pytest.mark.parametrize(
    ("times_s", "options", "due_s"),
    [
        ([50.0, 50.5, 52.0], {}, [0.0, 0.5, 2.0]),
        ([50.0, 50.5, 52.0], {"speed": 2.0}, [0.0, 0.25, 1.0]),
        ([50.0, 50.5, 52.0], {"speed": 0.0}, [0.0, 0.0, 0.0]),
        ([0.0, 1.0, 100.0, 101.0], {"skip_gaps_s": 5.0}, [0.0, 1.0, 6.0, 7.0]),
        ([0.0, 1.0, 100.0, 101.0], {"skip_gaps_s": 5.0, "speed": 10.0}, [0.0, 0.1, 0.6, 0.7]),
        # Two channels slightly out of order: due when they say, no time gained or lost over the rest.
        ([0.0, 1.0, 0.75, 1.25, 2.0], {}, [0.0, 1.0, 0.75, 1.25, 2.0]),
        # The recorder's clock stepped back by an hour.
        ([3600.0, 3601.0, 1.0, 2.0], {}, [0.0, 1.0, 1.0, 2.0]),
        ([3600.0, 3599.5, 3601.0], {}, [0.0, 0.0, 1.0]),
    ],
)
def test_due_times(times_s: list[float], options: dict, due_s: list[float]) -> None:
    schedule = Schedule(**options)
    assert [schedule.due_s(time_s) for time_s in times_s] == pytest.approx(due_s, abs=1e-12)


@given(
    st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=50),
    st.floats(0.1, 100.0),
    st.floats(0.0, 5.0),
)
def test_due_times_never_fall_back_by_more_than_disorder(steps_s, speed: float, skip_gaps_s: float) -> None:
    schedule = Schedule(speed, skip_gaps_s)
    time_s, latest_s = 100.0, 0.0
    for step_s in steps_s:
        time_s += step_s
        due_s = schedule.due_s(time_s)
        assert due_s >= 0
        assert latest_s - 1.0 / speed <= due_s <= latest_s + skip_gaps_s / speed + 1e-9
        latest_s = max(latest_s, due_s)


def test_a_late_frame_does_not_delay_the_rest() -> None:
    """Sending takes 4 ms of every 10: sleeping from frame to frame would end 40 % late."""
    clock = FakeClock(cost_s=0.004)
    progress = run([log(*(0.01 * k for k in range(1000)))], Schedule(), clock)
    assert [time_s for time_s, _ in clock.sent] == pytest.approx([0.01 * k for k in range(1000)], abs=1e-9)
    assert progress.elapsed_s == pytest.approx(9.994)
    assert (progress.sent, progress.late) == (1000, 0)
    assert progress.worst_lateness_s == pytest.approx(0.004)


def test_lateness_is_counted() -> None:
    clock = FakeClock(cost_s=0.02)
    progress = run([log(0.0, 0.01, 1.0)], Schedule(), clock)
    assert progress.late == 3
    assert progress.worst_lateness_s == pytest.approx(0.03)


def test_time_spent_before_the_first_frame_is_not_counted() -> None:
    clock = FakeClock()

    def slow_to_open():
        clock.now_s += 30.0
        yield from log(5.0, 6.0)

    progress = run([slow_to_open(), slow_to_open()], Schedule(), clock)
    assert [time_s for time_s, _ in clock.sent] == pytest.approx([30.0, 31.0, 61.0, 62.0])
    assert progress.late == 0


def test_passes_follow_each_other() -> None:
    clock = FakeClock()
    progress = run([log(0.0, 1.0)] * 3, Schedule(), clock)
    assert [time_s for time_s, _ in clock.sent] == pytest.approx([0.0, 1.0, 1.0, 2.0, 2.0, 3.0])
    assert progress.passes == 3


def test_an_empty_pass_ends_an_endless_replay() -> None:
    assert run(iter(list, None), Schedule(), FakeClock()).sent == 0


@pytest.mark.parametrize(
    ("options", "kept"),
    [
        ({}, [0, 1, 2, 3, 4, 5, 6, 7]),
        ({"fd": True}, [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        ({"inputs": FilterTable(CODEC.filters(["ElevatorSpeed", "VehiclePosition"]))}, [0, 1]),
        ({"channels": frozenset({"can1"})}, [3]),
        ({"from_s": 1.5}, [3, 4, 5, 6, 7]),
        ({"from_s": 1.5, "to_s": 4.0}, [3, 4, 5]),
        ({"to_s": 0.0}, []),
    ],
)
def test_selection(options: dict, kept: list[int]) -> None:
    speed_id, data = SPEED.arbitration_id, SPEED.data
    messages = [
        can.Message(timestamp=10.0, arbitration_id=speed_id, data=data, channel="can0"),
        can.Message(timestamp=10.5, arbitration_id=0x00FEF305, data=bytes(8), channel="can0"),
        can.Message(timestamp=11.0, arbitration_id=CODEC.layouts["MassFlow"].frame_id, data=bytes(8), channel="can0"),
        can.Message(timestamp=12.0, arbitration_id=0x7FF, is_extended_id=False, channel="can1"),
        can.Message(timestamp=13.0, arbitration_id=speed_id & 0x7FF, is_extended_id=False, data=data),
        can.Message(timestamp=13.5, arbitration_id=speed_id, is_remote_frame=True),
        can.Message(timestamp=14.0, arbitration_id=0x18FECA00, data=bytes(8)),
        can.Message(timestamp=14.0, arbitration_id=CODEC.layouts["ActiveDiagnostics"].frame_id, data=bytes(8)),
        can.Message(timestamp=14.0, arbitration_id=0x100, data=bytes(16), is_fd=True),
        can.Message(timestamp=14.0, is_error_frame=True),
    ]
    selected = list(Selection(**options).of(messages))
    assert [next(k for k, message in enumerate(messages) if message is chosen) for chosen in selected] == kept


class FullQueueBus(can.BusABC):
    """Refuses `refusals` times, with the error that a full transmit queue gives."""

    def __init__(self, refusals: float, code: int = errno.ENOBUFS) -> None:
        super().__init__(channel="full")
        self.refusals = refusals
        self.code = code
        self.taken: list[can.Message] = []

    def send(self, msg, timeout=None) -> None:
        if self.refusals > 0:
            self.refusals -= 1
            raise can.CanOperationError("Failed to transmit: No buffer space available", self.code)
        self.taken.append(msg)


def test_full_transmit_queue_is_waited_for() -> None:
    clock, bus = FakeClock(), FullQueueBus(refusals=50)
    with bus:
        Sender({None: bus}, clock=clock, sleep=clock.sleep).send(SPEED)
    assert len(bus.taken) == 1


@pytest.mark.parametrize("bus", [FullQueueBus(math.inf), FullQueueBus(1, errno.ENETDOWN)], ids=["never empty", "down"])
def test_a_bus_that_takes_nothing_is_an_error(bus: FullQueueBus) -> None:
    clock = FakeClock()
    with bus, pytest.raises(can.CanError):
        Sender({None: bus}, clock=clock, sleep=clock.sleep).send(SPEED)
    assert clock.now_s <= 1000.0 + 3.0


def test_channels_go_to_their_buses() -> None:
    with FullQueueBus(0) as one, FullQueueBus(0) as two:
        sender = Sender({"can0": one, "can1": two})
        for channel in ("can0", "can1", "can1"):
            sender.send(can.Message(channel=channel))
        assert (len(one.taken), len(two.taken)) == (1, 2)
