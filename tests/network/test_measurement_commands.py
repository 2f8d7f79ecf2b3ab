"""When a task controller gets a value: by time, distance, threshold and change, each limit met exactly and missed."""

from __future__ import annotations

import pytest

from tests.network.test_task_controller import device
from yieldmon.network.process_data import Command, ProcessData, Refusal
from yieldmon.network.task_controller.measurements import Measurements

FLOW = (2, 87)
LEAST, MOST = -(2**31), 2**31 - 1


def asked(command: Command, amount: int, ddi: int = 87) -> Measurements:
    measurements = Measurements(device())
    assert measurements.command(ProcessData(command, 2, ddi, amount), 10.0, 100.0) is Refusal.NONE
    return measurements


def sent(measurements: Measurements, steps: list[tuple[float, float, int]]) -> list[bool]:
    """Whether the value is sent at each step: time s, distance m, value."""
    return [measurements.due({FLOW: value}, time_s, distance_m) == [FLOW] for time_s, distance_m, value in steps]


@pytest.mark.parametrize(
    ("amount_ms", "times_s", "due"),
    [
        (1000, [10.5, 11.0, 11.5, 12.0, 13.0], [False, True, False, True, True]),
        (1000, [11.4, 12.0, 12.9, 13.0], [True, True, False, True]),
        (1000, [11.9, 12.0, 12.1], [True, True, False]),
        (1000, [12.0, 12.5, 13.0], [True, False, True]),
        (1000, [14.5, 15.0, 15.5], [True, False, True]),
        (1, [10.05, 10.1, 10.15, 10.2], [False, True, False, True]),
        (250, [10.125, 10.25, 10.375, 10.5], [False, True, False, True]),
    ],
    ids=["on the grid", "late once", "late and back on the grid", "one missed", "several missed", "no faster than 10 Hz", "4 Hz"],
)
def test_by_time(amount_ms: int, times_s: list[float], due: list[bool]) -> None:
    assert sent(asked(Command.TIME_INTERVAL, amount_ms), [(time_s, 100.0, 1) for time_s in times_s]) == due


def test_by_distance() -> None:
    steps = [(11.0, distance_m, 1) for distance_m in (105.0, 109.875, 110.0, 119.875, 121.0, 130.0, 131.0)]
    assert sent(asked(Command.DISTANCE_INTERVAL, 10_000), steps) == [False, False, True, False, True, False, True]


def test_on_change() -> None:
    steps = [(11.0, 100.0, value) for value in (50, 54, 55, 51, 50, 60)]
    assert sent(asked(Command.CHANGE_THRESHOLD, 5), steps) == [True, False, True, False, True, True]


@pytest.mark.parametrize(
    ("command", "due"),
    [
        (Command.MINIMUM_WITHIN_THRESHOLD, [False, False, True, False, False, True]),
        (Command.MAXIMUM_WITHIN_THRESHOLD, [True, False, False, False, True, False]),
    ],
)
def test_when_it_comes_within_a_threshold(command: Command, due: list[bool]) -> None:
    assert sent(asked(command, 10), [(11.0, 100.0, value) for value in (9, 10, 11, 12, 8, 13)]) == due


ENDS = [
    (Command.TIME_INTERVAL, 0), (Command.DISTANCE_INTERVAL, 0), (Command.CHANGE_THRESHOLD, 0),
    (Command.MINIMUM_WITHIN_THRESHOLD, LEAST), (Command.MAXIMUM_WITHIN_THRESHOLD, MOST),
]  # fmt: skip


@pytest.mark.parametrize(("command", "end"), ENDS)
def test_each_kind_ends_with_its_value_and_alone(command: Command, end: int) -> None:
    measurements = Measurements(device())
    for kind, _ in ENDS:
        measurements.command(ProcessData(kind, 2, 87, 5), 10.0, 100.0)
    assert len(measurements) == 5
    assert measurements.command(ProcessData(command, 2, 87, end), 10.0, 100.0) is Refusal.NONE
    assert len(measurements) == 4
    measurements.command(ProcessData(command, 2, 87, end), 10.0, 100.0)
    measurements.command(ProcessData(command, 2, 87, 6), 10.0, 100.0)
    assert len(measurements) == 5
    measurements.clear()
    assert len(measurements) == 0


@pytest.mark.parametrize("command", [Command.TIME_INTERVAL, Command.DISTANCE_INTERVAL, Command.CHANGE_THRESHOLD])
@pytest.mark.parametrize(("amount", "refusal"), [(-1, Refusal.BAD_INTERVAL), (LEAST, Refusal.BAD_INTERVAL), (1, Refusal.NONE)])
def test_intervals_are_not_negative(command: Command, amount: int, refusal: Refusal) -> None:
    assert Measurements(device()).command(ProcessData(command, 2, 87, amount), 10.0, 100.0) is refusal


@pytest.mark.parametrize("command", [Command.MINIMUM_WITHIN_THRESHOLD, Command.MAXIMUM_WITHIN_THRESHOLD])
@pytest.mark.parametrize("amount", [-1, 0])
def test_thresholds_may_be_anything(command: Command, amount: int) -> None:
    assert len(asked(command, amount)) == 1


def test_the_default_set_leaves_what_was_asked() -> None:
    measurements = asked(Command.TIME_INTERVAL, 3000)
    measurements.want_defaults(10.0, 100.0)
    values = {(2, ddi): 1 for ddi in (84, 87, 90, 99, 116, 119, 181, 182, 183, 239)}
    assert measurements.due(values, 10.9, 100.0) == []
    assert set(measurements.due(values, 11.0, 100.0)) == set(values) - {FLOW}
    assert set(measurements.due({**values, (0, 57343): 1}, 13.0, 100.0)) == set(values)
    assert measurements.due({}, 20.0, 100.0) == []
