"""Each limit of the sweep's machine met exactly, and missed by a 1,024th: times and angles that binary numbers carry exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from yieldmon.engine.settings import PlateSettings, SweepSettings
from yieldmon.engine.sweeps.plate_commands import PlateDemand
from yieldmon.engine.sweeps.sweep_inputs import PlateReading, SweepAbort, SweepWindow
from yieldmon.engine.sweeps.sweep_machine import SweepMachine
from yieldmon.frames import ActuatorState, CommandMode, SweepState

S, A = SweepState, ActuatorState
HOME, NAN = 70.0, float("nan")
SETTINGS = SweepSettings(
    interval_s=64.0, first_after_s=16.0, angles_deg=(40.0, 55.0, 90.0), home_every=2, windows_per_step=2, min_flow_kg_s=4.0,
    steady_windows=2, steady_cv=0.25, flow_change=0.25, flow_change_away=0.5, speed_change=0.125, move_margin_s=2.0, settle_s=0.5,
    settle_timeout_s=4.0, measure_timeout_s=8.0, signal_trend=5.0, return_timeout_s=8.0, home_rest_s=2.0, home_retry_s=16.0,
    backoff_s=8.0,
)  # fmt: skip
PLATE = PlateSettings(max_rate_deg_s=16.0, at_target_tolerance_deg=0.5)
WINDOW = SweepWindow(0.0, 0.0, 8.0, 32.0, 40.0, HOME, whole=True, still=True, trend=0.0)
BEYOND = 1.0 / 1024.0


class Sweep:
    """A machine at a time of its own."""

    def __init__(self, settings: SweepSettings = SETTINGS) -> None:
        self.machine = SweepMachine(settings, PLATE, HOME)
        self.now = 0.0
        self.demand: PlateDemand | None = None
        self.tick(0.0)

    @property
    def state(self) -> SweepState:
        return self.machine.state

    def tick(self, later_s: float, angle: float = HOME, state: ActuatorState = A.IDLE) -> Sweep:
        self.now += later_s
        self.demand = self.machine.tick(PlateReading(self.now, angle, state))
        return self

    def window(self, **change: object) -> int:
        window = replace(WINDOW, end_s=self.now, support_start_s=self.now - 1.0)
        return self.machine.window(replace(window, **change))  # type: ignore[arg-type]


def waiting() -> Sweep:
    return Sweep().tick(16.0)


def at_home() -> Sweep:
    """Under way: home is the first step."""
    sweep = waiting()
    sweep.window()
    sweep.window()
    return sweep.tick(1.0)


def settling(sweep: Sweep, angle: float = HOME) -> Sweep:
    return sweep.tick(0.125, angle)


def measuring(sweep: Sweep, angle: float = HOME) -> Sweep:
    return settling(sweep, angle).tick(0.5, angle)


def moving() -> Sweep:
    """From home to 40 degrees: 30 degrees at 16 a second and 2 s to spare."""
    sweep = measuring(at_home())
    sweep.now += 2.0
    sweep.window()
    sweep.window()
    return sweep


def away() -> Sweep:
    return measuring(moving(), 40.0)


def returning() -> Sweep:
    sweep = away()
    sweep.machine.abort(sweep.now)
    return sweep


def after(sweep: Sweep, later_s: float, angle: float = HOME) -> SweepState:
    return sweep.tick(later_s, angle).state


def counted(sweep: Sweep, **change: object) -> int:
    sweep.now += 2.0
    return sweep.window(**change)


def reason(sweep: Sweep, **change: object) -> SweepAbort | None:
    counted(sweep, **change)
    return sweep.machine.abort_reason


def begun(sweep: Sweep, angle: float = HOME, tick_angle: float = HOME, **change: object) -> bool:
    for _ in range(2):
        sweep.window(angle_deg=angle, **change)
    return sweep.tick(0.125, tick_angle).machine.visiting


def left_away(later_s: float) -> Sweep:
    """A plate that nobody drives rests at 50 degrees."""
    sweep = Sweep()
    sweep.machine.schedule.by_schedule = False
    return sweep.tick(1.0, 50.0).tick(later_s, 50.0)


def tried_again(later_s: float) -> SweepState:
    """It did not get home in time: the next try waits."""
    sweep = left_away(2.0).tick(8.125, 50.0).tick(0.0, 50.0)
    return after(sweep, later_s, 50.0)


LIMITS: dict[str, tuple[Callable[[float], object], object, object]] = {
    # what happens at a limit and so much beyond it; the outcome at the limit; beyond it
    "first sweep due": (lambda e: after(Sweep(), 16.0 - e), S.WAITING, S.IDLE),
    "travel": (lambda e: after(moving(), 3.875 + e, 50.0), S.MOVING, S.RETURNING),
    "travel at home": (lambda e: after(at_home(), 2.0 + e, 50.0), S.MOVING, S.RETURNING),
    "on target": (lambda e: after(moving(), 1.0, 40.5 + e), S.SETTLING, S.MOVING),
    "on target from below": (lambda e: after(moving(), 1.0, 39.5 - e), S.SETTLING, S.MOVING),
    "settled": (lambda e: after(settling(moving(), 40.0), 0.5 - e, 40.0), S.MEASURING, S.SETTLING),
    "settles in time": (lambda e: after(settling(moving(), 40.0), 4.0 + e, 45.0), S.SETTLING, S.RETURNING),
    "leaves and settles in time": (lambda e: after(away().tick(1.0, 45.0), 4.0 + e, 45.0), S.SETTLING, S.RETURNING),
    "measured in time": (lambda e: after(away(), 8.0 + e, 40.0), S.MEASURING, S.RETURNING),
    "window after settling": (lambda e: counted(away(), support_start_s=away().now - e), 1, -1),
    "trend": (lambda e: counted(away(), trend=5.0 + e), 1, -1),
    "speed up": (lambda e: reason(away(), speed_rad_s=45.0 + e), None, SweepAbort.SPEED_CHANGED),
    "speed down": (lambda e: reason(away(), speed_rad_s=35.0 - e), None, SweepAbort.SPEED_CHANGED),
    "flow at home up": (lambda e: reason(measuring(at_home()), flow_kg_s=10.0 + e), None, SweepAbort.FLOW_CHANGED),
    "flow at home down": (lambda e: reason(measuring(at_home()), flow_kg_s=6.0 - e), None, SweepAbort.FLOW_CHANGED),
    "flow away": (lambda e: reason(away(), flow_kg_s=12.0 + e), None, SweepAbort.FLOW_CHANGED),
    "least flow": (lambda e: begun(waiting(), flow_kg_s=4.0 - e), True, False),
    "windows near home": (lambda e: begun(waiting(), angle=71.0 + e), True, False),
    "begins near home": (lambda e: begun(waiting(), tick_angle=71.0 + e), True, False),
    "home": (lambda e: after(returning(), 1.0, 70.5 + e), S.ABORTED, S.RETURNING),
    "home in time": (lambda e: after(returning(), 8.0 + e, 50.0), S.RETURNING, S.ABORTED),
    "left away": (lambda e: left_away(2.0 - e).state, S.RETURNING, S.IDLE),
    "left away, far": (lambda e: Sweep().tick(1.0, 71.0 + e).tick(2.0, 71.0 + e).state, S.IDLE, S.RETURNING),
    "tried again": (lambda e: tried_again(16.0 - e), S.RETURNING, S.IDLE),
}


@pytest.mark.parametrize("name", LIMITS)
def test_limit(name: str) -> None:
    happens, at, beyond = LIMITS[name]
    assert (happens(0.0), happens(BEYOND)) == (at, beyond)


@pytest.mark.parametrize(("unsteady", "begins"), [((8.0, 8.0), True), ((8.0, 10.5), True), ((8.0, 12.0), False)])
def test_flow_is_steady_within_a_quarter(unsteady: tuple[float, float], begins: bool) -> None:
    """Standard deviations over means of two: 0, 0.19, 0.28."""
    sweep = waiting()
    for flow in unsteady:
        sweep.window(flow_kg_s=flow)
    assert sweep.tick(0.125).machine.visiting is begins


@pytest.mark.parametrize(("speeds", "begins"), [((40.0, 40.0), True), ((40.0, 43.0), True), ((40.0, 44.0), False)])
def test_speed_is_steady_within_half_its_change(speeds: tuple[float, float], begins: bool) -> None:
    """0.051 and 0.067 of 0.0625."""
    sweep = waiting()
    for speed in speeds:
        sweep.window(speed_rad_s=speed)
    assert sweep.tick(0.125).machine.visiting is begins


@pytest.mark.parametrize(
    "change", [{"whole": False}, {"still": False}, {"flow_kg_s": NAN}, {"angle_deg": 80.0}, {"angle_deg": 60.0}]
)
def test_a_window_that_is_not_good_begins_the_count_anew(change: dict[str, object]) -> None:
    sweep = waiting()
    for one in ({}, change, {}):
        sweep.window(**one)
        assert not sweep.tick(0.125).machine.visiting
    sweep.window()
    assert sweep.tick(0.125).machine.visiting


def test_a_whole_sweep_step_by_step() -> None:
    sweep, seen = at_home(), []
    for angle in (70.0, 40.0, 55.0, 70.0, 90.0, 70.0):
        assert (sweep.state, sweep.machine.progress_pct) == (S.MOVING, pytest.approx(100.0 * len(seen) / 6.0))
        assert sweep.tick(0.125, 60.0).demand == PlateDemand(CommandMode.GO_TO_ANGLE, angle)
        measuring(sweep, angle)
        assert sweep.demand == PlateDemand(CommandMode.GO_TO_ANGLE, angle)
        seen.append([counted(sweep, angle_deg=angle) for _ in range(2)])
    machine = sweep.machine
    assert seen == [[step, step] for step in range(6)]
    assert (machine.completed, machine.sweep_id, machine.driving, machine.lead) == (True, 1, True, 0)
    assert sweep.window() == -1, "nothing counts after the last step"
    machine.finish(sweep.now, updated=True)
    assert (machine.completed, machine.step, machine.progress_pct, machine.state) == (False, -1, 100.0, S.UPDATED)
    assert machine.schedule.remaining_s(sweep.now + 4.0) == 60.0


def test_waits_after_aborts_double_up_to_the_interval_and_begin_anew_after_a_whole_sweep() -> None:
    sweep = Sweep()
    assert sweep.machine.schedule.remaining_s(6.0) == 10.0
    waits = []
    for _ in range(5):
        sweep.machine.request()
        assert sweep.machine.schedule.requested
        assert begun(sweep)
        assert not sweep.machine.schedule.requested
        sweep.machine.abort(sweep.now)
        waits.append(sweep.machine.schedule.remaining_s(sweep.now))
        assert (sweep.machine.step, sweep.machine.completed, sweep.machine.progress_pct) == (-1, False, 0.0)
        sweep.tick(0.125)
    assert waits == [8.0, 16.0, 32.0, 64.0, 64.0]
    assert sweep.machine.sweep_id == 5
    sweep.machine.finish(sweep.now, updated=False)
    assert (sweep.state, sweep.machine.schedule.remaining_s(sweep.now)) == (S.NOT_LEARNED, 64.0)
    sweep.machine.request()
    assert begun(sweep)
    sweep.machine.abort(sweep.now)
    assert sweep.machine.schedule.remaining_s(sweep.now) == 8.0


def test_a_request_is_withdrawn_by_an_abort_and_a_waiting_sweep_put_off() -> None:
    sweep = Sweep()
    sweep.machine.request()
    sweep.machine.abort(sweep.now)
    assert (sweep.machine.schedule.requested, sweep.tick(0.125).state) == (False, S.IDLE)
    sweep = waiting()
    sweep.machine.abort(sweep.now)
    assert (sweep.state, sweep.machine.schedule.remaining_s(sweep.now), sweep.machine.abort_reason) == (S.IDLE, 64.0, None)


def test_a_withdrawn_request_leaves_the_schedule_as_it_was() -> None:
    sweep = Sweep()
    sweep.tick(0.125)
    due_s = sweep.now + sweep.machine.schedule.remaining_s(sweep.now)
    sweep.machine.request()
    assert sweep.tick(1.0).state is S.WAITING
    assert sweep.machine.abort(sweep.now)
    assert sweep.state is S.IDLE
    assert sweep.now + sweep.machine.schedule.remaining_s(sweep.now) == due_s
    assert sweep.tick(0.125).state is S.IDLE


@pytest.mark.parametrize(
    ("how", "stays"),
    [
        (SweepAbort.OPERATOR, False),
        (SweepAbort.FLOW_CHANGED, False),
        (SweepAbort.NOT_FOLLOWING, True),
        (SweepAbort.FORCE_DOES_NOT_FOLLOW, True),
    ],
)
def test_a_plate_that_did_not_follow_is_reported_until_it_follows(how: SweepAbort, stays: bool) -> None:
    """However it came home; the next movement that arrives ends it, and the first step of a sweep, at home, is none."""
    sweep = moving().tick(3.875 + BEYOND, 50.0)
    assert (sweep.machine.not_following, sweep.machine.abort_reason) == (True, SweepAbort.NOT_FOLLOWING)
    sweep.tick(1.0)
    sweep.machine.request()
    assert begun(sweep)
    sweep.machine.abort(sweep.now, how)
    assert sweep.machine.not_following
    sweep.tick(1.0)
    assert sweep.machine.not_following is stays
    sweep.machine.request()
    assert begun(sweep)
    measuring(sweep)
    assert sweep.machine.not_following is stays
    sweep.now += 2.0
    sweep.window()
    sweep.window()
    settling(sweep, 40.0)
    assert not sweep.machine.not_following


def test_a_plate_whose_feedback_stays_at_home_is_driven_home_all_the_same() -> None:
    """For as long as it may have travelled, and 2 s."""
    sweep = moving().tick(3.875 + BEYOND)
    assert (sweep.machine.abort_reason, sweep.demand) == (SweepAbort.NOT_FOLLOWING, PlateDemand(CommandMode.GO_HOME))
    sweep.tick(3.875 - BEYOND)
    assert (sweep.state, sweep.demand) == (S.RETURNING, PlateDemand(CommandMode.GO_HOME))
    sweep.tick(BEYOND)
    assert (sweep.state, sweep.demand, sweep.machine.not_following) == (S.ABORTED, PlateDemand(CommandMode.RELEASE), True)


def test_a_plate_whose_feedback_moves_is_home_when_it_says_so() -> None:
    sweep = moving().tick(3.875 + BEYOND, 50.0).tick(0.125)
    assert (sweep.state, sweep.demand) == (S.ABORTED, PlateDemand(CommandMode.RELEASE))


def test_a_plate_that_does_not_come_home_in_time_is_reported() -> None:
    """At the limit it may still come; beyond it the plate is given up for a while, and it has not followed."""
    sweep = left_away(2.0)
    assert (sweep.state, sweep.machine.not_following) == (S.RETURNING, False)
    sweep.tick(SETTINGS.return_timeout_s, 50.0)
    assert (sweep.state, sweep.machine.not_following) == (S.RETURNING, False)
    sweep.tick(BEYOND, 50.0)
    assert (sweep.state, sweep.machine.not_following) == (S.IDLE, True)
    assert sweep.demand == PlateDemand(CommandMode.RELEASE)


def test_a_hand_ends_the_return_and_the_next_try_does_not_wait() -> None:
    sweep = left_away(2.0)
    assert sweep.demand == PlateDemand(CommandMode.GO_HOME)
    sweep.tick(1.0, 50.0, A.MANUAL)
    assert (sweep.state, sweep.demand) == (S.IDLE, PlateDemand(CommandMode.RELEASE))
    sweep.tick(0.125, 50.0).tick(2.0, 50.0)
    assert sweep.state is S.RETURNING


@pytest.mark.parametrize("state", [A.MOVING, A.MANUAL, A.FAULT])
def test_a_plate_that_others_drive_is_not_taken_home(state: ActuatorState) -> None:
    sweep = Sweep().tick(1.0, 50.0, state)
    assert (sweep.tick(2.0, 50.0, state).state, sweep.demand) == (S.IDLE, None)
    assert sweep.tick(0.125, 50.0).tick(1.0, 50.0).state is S.IDLE, "its rest begins when it is let go"


def test_a_plate_that_moves_has_not_settled() -> None:
    sweep = settling(moving(), 40.0)
    sweep.tick(0.5, 40.0, A.MOVING).tick(0.125, 40.0)
    assert after(sweep, 0.375, 40.0) is S.SETTLING
    assert after(sweep, 0.125, 40.0) is S.MEASURING


@pytest.mark.parametrize(
    ("flows", "forces", "found"),
    [
        ((8.0, 6.0), (32.0, 32.0), True),
        ((8.0, 6.0), (32.0, 28.5), True),
        ((8.0, 6.0), (32.0, 27.0), False),
        ((8.0, 7.5), (32.0, 32.0), False),
        ((8.0, 0.0), (32.0, 32.0), False),
        ((8.0, 6.0), (32.0, 0.0), False),
        ((8.0, 6.0), (32.0, -1.0), False),
    ],
)
def test_a_force_steadier_than_half_the_flow_made_from_it_shows_a_plate_that_never_moved(
    flows: tuple[float, float], forces: tuple[float, float], found: bool
) -> None:
    """Spreads of ln(flow): 0.203 of 8 and 6, 0.046 of 8 and 7.5; of ln(force): 0.082 and 0.120. Asked from 0.08 on."""
    sweep = measuring(at_home())
    for flow, force in zip(flows, forces, strict=True):
        counted(sweep, flow_kg_s=flow, force_n=force)
    sweep.machine.abort(sweep.now)
    assert sweep.machine.implausible_feedback() is found


def test_nothing_seen_is_no_sign_of_a_plate_that_never_moved() -> None:
    assert not Sweep().machine.implausible_feedback()
