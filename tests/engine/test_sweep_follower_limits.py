"""Each limit of the follower of a log's sweeps met exactly, and missed by a 1,024th."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from test_sweep_limits import BEYOND, HOME, NAN, PLATE, SETTINGS, WINDOW

from yieldmon.engine.sweeps.sweep_follower import SweepFollower
from yieldmon.engine.sweeps.sweep_inputs import PlateReading, SweepAbort
from yieldmon.frames import ActuatorState, SweepState

S, A = SweepState, ActuatorState
WATCHED = replace(SETTINGS, measure_timeout_s=8.0)


class Log:
    """A follower that has seen steady windows at home, at a time of its own."""

    def __init__(self, windows: int = 2, **change: object) -> None:
        self.follower = SweepFollower(WATCHED, PLATE, HOME)
        self.now = 100.0
        self.windows(windows, HOME, **change)

    @property
    def state(self) -> SweepState:
        return self.follower.state

    def windows(self, count: int, angle: float, **change: object) -> list[int]:
        steps = []
        for _ in range(count):
            self.now += 1.0
            window = replace(WINDOW, end_s=self.now, support_start_s=self.now - 1.0, angle_deg=angle)
            steps.append(self.follower.window(replace(window, **change)))  # type: ignore[arg-type]
        return steps

    def tick(self, later_s: float, angle: float, state: ActuatorState = A.IDLE) -> Log:
        self.now += later_s
        self.follower.tick(PlateReading(self.now, angle, state))
        return self

    def leaves(self, angle: float = 40.0) -> Log:
        self.windows(1, angle, still=False)
        return self

    def stops(self, angle: float) -> Log:
        """The plate comes to rest and is measured."""
        return self.tick(0.125, angle, A.MOVING).tick(0.125, angle).tick(0.5, angle)


def stopped(angle: float = 40.0) -> Log:
    return Log().leaves(angle).stops(angle)


def back_home(*angles: float) -> Log:
    log = Log().leaves(angles[0])
    for angle in (*angles, HOME):
        log.stops(angle)
    return log


def settled(later_s: float) -> SweepState:
    log = Log().leaves().tick(0.125, 40.0, A.MOVING).tick(0.125, 40.0)
    return log.tick(later_s, 40.0).state


def begun(**change: object) -> bool:
    return Log(**change).leaves().follower.visiting


def at(log: Log, later_s: float, angle: float) -> tuple[SweepState, bool]:
    """A window ends so much after the last stop began."""
    log.now += later_s - 1.0
    log.windows(1, angle)
    return log.state, log.follower.completed


LIMITS: dict[str, tuple[Callable[[float], object], object, object]] = {
    # what happens at a limit and so much beyond it; the outcome at the limit; beyond it
    "home is near": (lambda e: begun(angle_deg=71.0 + e), True, False),
    "home is near, below": (lambda e: begun(angle_deg=69.0 - e), True, False),
    "least flow": (lambda e: begun(flow_kg_s=4.0 - e), True, False),
    "settled": (lambda e: settled(0.5 - e), S.MEASURING, S.MOVING),
    "the same stop": (lambda e: stopped().tick(1.0, 41.0 + e).state, S.MEASURING, S.MOVING),
    "trend": (lambda e: stopped().windows(2, 40.0, trend=5.0 + e)[1], 1, -1),
    "window after settling": (lambda e: stopped().windows(1, 40.0, support_start_s=103.75 - e)[0], 1, -1),
    "flow away": (lambda e: changed(40.0, flow_kg_s=12.0 + e), None, SweepAbort.FLOW_CHANGED),
    "speed away": (lambda e: changed(40.0, speed_rad_s=45.0 + e), None, SweepAbort.SPEED_CHANGED),
    "flow at home": (lambda e: changed(HOME, flow_kg_s=10.0 + e), None, SweepAbort.FLOW_CHANGED),
    "stands there for good": (lambda e: at(stopped(), 80.0 + e, 40.0)[0], S.MEASURING, S.IDLE),
    "another sequence has ended": (lambda e: at(back_home(50.0, 90.0), 8.0 + e, HOME)[1], False, True),
    "too few angles": (lambda e: at(back_home(50.0), 8.0 + e, HOME), (S.MEASURING, False), (S.IDLE, False)),
}


def changed(angle: float, **change: object) -> SweepAbort | None:
    log = Log().leaves().stops(angle)
    log.windows(1, angle)
    log.windows(1, angle, **change)
    return log.follower.abort_reason


@pytest.mark.parametrize("name", LIMITS)
def test_limit(name: str) -> None:
    happens, exactly, beyond = LIMITS[name]
    assert (happens(0.0), happens(BEYOND)) == (exactly, beyond)


@pytest.mark.parametrize(
    ("change", "begins"),
    [({}, True), ({"whole": False}, False), ({"flow_kg_s": 0.0}, False), ({"flow_kg_s": NAN}, False), ({"still": False}, False)],
)
def test_a_sweep_begins_after_steady_windows(change: dict[str, object], begins: bool) -> None:
    assert begun(**change) is begins
    assert not Log(1).leaves().follower.visiting, "too few"
    assert not Log().leaves().follower.completed


def test_the_configured_sequence_has_ended_with_its_last_windows_at_home() -> None:
    log = Log().leaves()
    follower = log.follower
    assert (follower.sequence, follower.step, follower.sweep_id, follower.lead) == ((HOME,), 0, 1, 0)
    for step, angle in enumerate((40.0, 55.0, HOME, 90.0, HOME), 1):
        log.stops(angle + 0.04).now += 1.0
        assert not follower.completed
        assert log.windows(1, angle) == [step]
        assert not follower.completed
        assert log.windows(1, angle) == [step]
    assert (follower.completed, follower.sequence) == (True, (HOME, 40.0, 55.0, HOME, 90.0, HOME))
    assert log.windows(1, HOME) == [-1]
    follower.finish(log.now, updated=True)
    assert (follower.state, follower.completed) == (S.UPDATED, False)


def test_windows_before_it_belong_to_it() -> None:
    follower = Log(5).follower
    assert follower.lead == WATCHED.windows_per_step == 2
    assert Log(1).follower.lead == 1
    assert stopped().follower.lead == 0


@pytest.mark.parametrize(
    ("angle", "state", "after", "reason"),
    [
        (40.0, A.MANUAL, S.IDLE, None),
        (40.0, A.FAULT, S.ABORTED, SweepAbort.ACTUATOR_FAULT),
        (NAN, A.IDLE, S.ABORTED, SweepAbort.FEEDBACK_STALE),
    ],
)
def test_what_ends_it(angle: float, state: ActuatorState, after: SweepState, reason: SweepAbort | None) -> None:
    log = stopped().tick(1.0, angle, state)
    assert (log.state, log.follower.abort_reason, log.follower.step) == (after, reason, -1)
    log.windows(2, HOME)
    assert log.leaves().follower.sweep_id == 2
    assert (log.follower.abort_reason, log.state) == (None, S.MOVING)


def test_an_abort_counts_only_while_one_is_followed_and_no_request_is_taken() -> None:
    log = Log()
    log.follower.abort(log.now, SweepAbort.FORCE_DOES_NOT_FOLLOW)
    log.follower.request()
    assert (log.state, log.follower.abort_reason, log.follower.not_following) == (S.IDLE, None, False)
    assert not log.follower.schedule.requested
    for reason, not_following in ((SweepAbort.FORCE_DOES_NOT_FOLLOW, True), (SweepAbort.OPERATOR, False)):
        log = stopped()
        log.follower.abort(log.now, reason)
        assert (log.state, log.follower.abort_reason, log.follower.not_following) == (S.ABORTED, reason, not_following)


def test_switched_off_none_is_followed() -> None:
    log = Log(0)
    log.follower = SweepFollower(replace(WATCHED, enabled=False), PLATE, HOME)
    log.windows(3, HOME)
    assert not log.leaves().follower.visiting
