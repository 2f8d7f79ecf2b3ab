"""Signs of a second sender of one slow input, at the edges of what one sender does."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.duplicate_senders import (
    DuplicateSenderWatch,
    SignalLimits,
    TankWatch,
    angle_limits,
    speed_limits,
    tank_leaps,
)
from yieldmon.physics.machine import Machine

LIMITS = SignalLimits(interval_s=0.1, step=5.0, rate=10.0)
"""Ten values a second, none 6 from the one a tenth of a second before it."""


def judged(windows: list[list[float]], limits: SignalLimits = LIMITS, at_once: bool = True) -> list[int]:
    """Values of each second that a second sender accounts for; a window's values are spread over it."""
    watch, found = DuplicateSenderWatch(limits), list[int]()
    groups = [range(len(windows))] if at_once else [[k] for k in range(len(windows))]
    for group in groups:
        times = [k + (n + 0.5) / max(1, len(windows[k])) for k in group for n in range(len(windows[k]))]
        values = [value for k in group for value in windows[k]]
        bounds = np.concatenate(([0], np.cumsum([len(windows[k]) for k in group])))
        found += watch.take(np.array(times), np.array(values), bounds, np.array([*group, group[-1] + 1], float)).tolist()
    return found


@pytest.mark.parametrize("at_once", [True, False])
@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        ([10, 14, 10], [0, 0, 0]),
        ([10, 15, 10], [0, 1, 0]),
        ([10, 30, 30], [0, 16, 16]),
        ([4, 20, 10], [0, 0, 0]),
        ([4, 21, 10], [0, 1, 0]),
        ([0, 24, 25], [0, 0, 11]),
    ],
    ids=["a few more", "one too many", "three times", "late ones", "more than were late", "late only once"],
)
def test_more_values_than_one_sender_has(counts: list[int], expected: list[int], at_once: bool) -> None:
    assert judged([[50.0] * count for count in counts], at_once=at_once) == expected


def test_without_a_known_cycle_there_are_never_too_many() -> None:
    assert judged([[50.0] * 10, [50.0] * 200], SignalLimits(nan, 5.0, 10.0)) == [0, 0]


STEADY = [50.0] * 10


@pytest.mark.parametrize("at_once", [True, False])
@pytest.mark.parametrize(
    ("windows", "expected"),
    [
        ([[50.0] * 4 + [56.1] + [50.0] * 5, STEADY, STEADY], [2, 0, 0]),
        ([[50.0] * 4 + [43.9] + [50.0] * 5, STEADY, STEADY], [2, 0, 0]),
        ([[50.0] * 4 + [55.9] + [50.0] * 5, STEADY, STEADY], [0, 0, 0]),
        ([[50.0] * 4 + [70.0] * 6, [70.0] * 10, [70.0] * 10], [0, 0, 0]),
        ([[50.0] * 4 + [70.0] * 6, [70.0] * 4 + [50.0] * 6, STEADY], [0, 1, 0]),
        ([[50.0] * 4 + [70.0] * 6, [70.0] * 10, [70.0] * 4 + [50.0] * 6], [0, 0, 0]),
        ([[70.0] * 5 + [50.0] * 5, STEADY, STEADY], [0, 0, 0]),
        ([STEADY, [70.0], [50.0] * 10], [0, 0, 0]),
        ([[50.0] * 5 + [80.0, 50.0, 80.0, 50.0, 80.0], STEADY, STEADY], [5, 1, 0]),
    ],
    ids=["up and down", "down and up", "as far as it may", "up for good", "down a second later", "down two later", "down alone",
         "after a pause", "to and fro"],
)  # fmt: skip
def test_values_that_leap_both_ways(windows: list[list[float]], expected: list[int], at_once: bool) -> None:
    assert judged(windows, at_once=at_once) == expected


@pytest.mark.parametrize(
    ("step_s", "change", "leaps"),
    [
        (0.25, 7.5, False), (0.25, 7.625, True), (0.25, -7.5, False), (0.25, -7.625, True), (0.0, 5.0, False), (0.0, 5.125, True),
        (0.5, 10.125, True), (0.5, 10.0, False), (0.625, 90.0, False), (-0.25, 5.125, True), (-0.25, 5.0, False),
        (-0.625, 90.0, False),
    ],
)  # fmt: skip
def test_a_leap_is_more_than_step_and_rate_within_half_a_second(step_s: float, change: float, leaps: bool) -> None:
    """In numbers that binary fractions hold: 5 and 10 a second are met exactly, and missed by an eighth."""
    watch = DuplicateSenderWatch(SignalLimits(nan, 5.0, 10.0))
    times = np.array([1.0, 1.0 + step_s, 1.0 + step_s + max(0.0, step_s)])
    found = watch.take(times, np.array([50.0, 50.0 + change, 50.0]), np.array([0, 3]), np.array([0.0, 3.0]))
    assert found.tolist() == [2 * leaps]


@given(
    st.lists(st.lists(st.sampled_from([50.0, 52.0, 70.0, 30.0]), max_size=6), min_size=1, max_size=5),
)
def test_windows_judged_together_are_judged_as_one_by_one(windows: list[list[float]]) -> None:
    assert judged(windows, at_once=True) == judged(windows, at_once=False)


NOMINAL = Machine().nominal_elevator_speed_rad_s


@pytest.mark.parametrize(
    ("limits", "value", "change", "leaps"),
    [
        (speed_limits(Machine(), 0.1), NOMINAL, 0.24 * NOMINAL, False),
        (speed_limits(Machine(), 0.1), NOMINAL, 0.26 * NOMINAL, True),
        (angle_limits(0.1), np.radians(70.0), np.radians(5.4), False),
        (angle_limits(0.1), np.radians(70.0), np.radians(5.6), True),
    ],
    ids=["a clutch", "faster than a clutch", "a plate", "faster than a plate"],
)
def test_the_machine_is_no_faster_than_that(limits: SignalLimits, value: float, change: float, leaps: bool) -> None:
    """In a tenth of a second: a seventh of the nominal speed and all of it in a second; 1.5 degrees and 40 in a second."""
    assert judged([[value] * 4 + [value + change] + [value] * 5], limits) == [2 * leaps]


@pytest.mark.parametrize(
    ("step_s", "change_kg", "leaps"),
    [
        (1.0, 400.0, False), (1.0, 401.0, True), (1.0, -401.0, True), (0.0, 100.0, False), (0.0, 101.0, True),
        (1.5, 550.0, False), (1.5, 551.0, True), (1.6, 5000.0, False), (-1.0, 101.0, True), (-1.6, 5000.0, False),
    ],
)  # fmt: skip
def test_what_no_tank_gains_or_loses(step_s: float, change_kg: float, leaps: bool) -> None:
    assert tank_leaps(step_s, change_kg) is leaps


@pytest.mark.parametrize(
    ("readings", "disputed_s"),
    [
        ([(0, 1000), (1, 2000), (2, 1000)], 2.0),
        ([(0, 2000), (1, 1000), (2, 2000)], 2.0),
        ([(0, 1000), (1, 2000), (2, 2010), (3, 2020)], -inf),
        ([(0, 1000), (1, 2000), (2, 2000), (3, 2000), (4, 1000)], 4.0),
        ([(0, 1000), (1, 2000), (2, 2000), (3, 2000), (4, 2000), (5, 1000)], -inf),
        ([(0, 1000), (1, 1300), (2, 1000)], -inf),
    ],
    ids=["up, down", "down, up", "up for good", "three seconds apart", "four seconds apart", "as an auger does"],
)
def test_readings_of_a_tank_that_contradict_each_other(readings: list[tuple[float, float]], disputed_s: float) -> None:
    watch = TankWatch()
    for time_s, mass_kg in readings:
        watch.take(float(time_s), float(mass_kg))
    assert watch.disputed_s == disputed_s
    assert watch.copy().disputed_s == disputed_s
