"""Bus time to engine time: which steps are jumps, and that nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.engine.clock import BusClock
from yieldmon.engine.settings import ClockSettings

SETTINGS = ClockSettings(max_gap_s=60.0, backstep_tolerance_s=0.1)


def clock_at(bus_s: float = 1000.0) -> BusClock:
    clock = BusClock(SETTINGS)
    assert clock.engine_time(bus_s) == bus_s
    return clock


@pytest.mark.parametrize(
    ("step_s", "engine_step_s", "now_step_s", "jumps"),
    [
        (0.0, 0.0, 0.0, 0), (0.004, 0.004, 0.004, 0), (60.0, 60.0, 60.0, 0), (60.5, 0.0, 0.0, 1), (1e6, 0.0, 0.0, 1),
        (-0.05, -0.05, 0.0, 0), (-0.15, 0.0, 0.0, 1), (-3600.0, 0.0, 0.0, 1),
    ],
)  # fmt: skip
def test_a_step(step_s, engine_step_s, now_step_s, jumps):
    clock = clock_at()
    assert clock.engine_time(1000.0 + step_s) == pytest.approx(1000.0 + engine_step_s)
    assert clock.now_s == pytest.approx(1000.0 + now_step_s)
    assert clock.jumps == jumps
    # After a jump time goes on from where it was, and bus times are those of the new clock.
    assert clock.engine_time(1001.0 + step_s + (-engine_step_s + now_step_s)) == pytest.approx(1001.0 + now_step_s)
    assert clock.bus_time(clock.now_s) == pytest.approx(1001.0 + step_s + (-engine_step_s + now_step_s))


def test_times_that_go_to_and_fro_make_no_silence():
    """Two recorders' frames, line by line, their clocks half a minute apart: an hour of it was 25 hours."""
    clock = clock_at()
    for number in range(1, 501):
        clock.engine_time(1000.0 + 0.01 * number + 30.0 * (number % 2))
    assert clock.now_s < 1000.0 + 5.0 + 31.0
    assert not clock.regular(np.array([1006.0]))


def test_a_pause_long_after_a_step_is_a_pause():
    clock = clock_at()
    clock.engine_time(500.0)
    for number in range(1, 41):
        clock.engine_time(500.0 + 0.01 * number)
    before_s = clock.now_s
    assert clock.regular(np.array([530.0]))
    clock.engine_time(530.4)
    assert clock.now_s == pytest.approx(before_s + 30.0)
    assert clock.jumps == 1


@pytest.mark.parametrize(("step_s", "jumps"), [(30.0, 0), (1800.0, 0), (-1800.0, 1)])
def test_a_pause_between_two_logs_is_no_jump(step_s, jumps):
    clock = clock_at()
    clock.begin_log()
    before_s = clock.now_s
    clock.engine_time(1000.0 + step_s)
    assert (clock.jumps, clock.paused_s) == (jumps, step_s if step_s > 60.0 else 0.0)
    assert clock.now_s == pytest.approx(before_s + (step_s if step_s == 30.0 else 0.0))
    # Within that log a long step is one again.
    clock.engine_time(clock.bus_time(clock.now_s) + 1800.0)
    assert clock.jumps == jumps + 1


@pytest.mark.parametrize("bus_s", [float("nan"), float("inf"), -1e12, 2e11])
def test_a_time_that_is_none_is_counted_and_not_used(bus_s):
    clock = clock_at()
    assert clock.engine_time(bus_s) is None
    assert (clock.unusable, clock.jumps, clock.now_s) == (1, 0, 1000.0)


@pytest.mark.parametrize(
    ("times_s", "expected"),
    [
        ([1000.0, 1000.0, 1001.0], True), ([1000.5, 1060.0], True), ([1000.5, 1060.6], False), ([1061.0], False),
        ([999.99], False), ([1000.2, 1000.1], False), ([], False),
    ],
)  # fmt: skip
def test_a_block_that_needs_no_care(times_s, expected):
    assert clock_at().regular(np.array(times_s)) is expected


def test_no_block_is_regular_before_the_first_time():
    assert not BusClock(SETTINGS).regular(np.array([1.0, 2.0]))
