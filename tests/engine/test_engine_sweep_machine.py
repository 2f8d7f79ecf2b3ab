"""The sweep's states: every transition, by table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import pytest
from engine_bench import MACHINE

from yieldmon.engine.settings import PlateSettings, SweepSettings
from yieldmon.engine.sweeps.plate_commands import PlateDemand
from yieldmon.engine.sweeps.sweep import sweep_sequence
from yieldmon.engine.sweeps.sweep_inputs import PlateReading, SweepAbort, SweepWindow, support_start_s
from yieldmon.engine.sweeps.sweep_machine import SweepMachine
from yieldmon.frames import ActuatorState, CommandMode, SweepState
from yieldmon.physics.machine import RPM

S = SweepState
HOME = 70.0
NAN = float("nan")
SETTINGS = SweepSettings(first_after_s=20.0, angles_deg=(40.0, 55.0, 90.0), steady_windows=3)


class Rig:
    """A machine, a clock, and a plate that goes where the test puts it."""

    def __init__(self, settings: SweepSettings = SETTINGS) -> None:
        self.machine = SweepMachine(settings, PlateSettings(), HOME)
        self.now = 0.0
        self.angle = HOME
        self.actuator = ActuatorState.IDLE
        self.demand: PlateDemand | None = None
        self.flow = 10.0
        self.force = 40.0
        self.speed = 42.0
        self.step = -1

    @property
    def state(self) -> SweepState:
        return self.machine.state

    def tick(self, seconds: float = 0.1) -> None:
        self.now += seconds
        self.demand = self.machine.tick(PlateReading(self.now, self.angle, self.actuator))

    def ticks(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.1)):
            self.tick()

    def window(self, **change: object) -> None:
        window = SweepWindow(
            end_s=self.now,
            support_start_s=self.now - 1.2,
            flow_kg_s=self.flow,
            force_n=self.force,
            speed_rad_s=self.speed,
            angle_deg=self.angle,
            whole=True,
            still=True,
            trend=0.5,
        )
        self.step = self.machine.window(replace(window, **change))  # type: ignore[arg-type]

    def follow(self) -> None:
        """The plate follows a command at once."""
        self.tick()
        if self.demand is not None and self.demand.mode is CommandMode.GO_TO_ANGLE:
            self.angle = self.demand.target_deg
        elif self.demand is not None and self.demand.mode is CommandMode.GO_HOME:
            self.angle = HOME


def idle() -> Rig:
    rig = Rig()
    rig.tick()
    return rig


def waiting() -> Rig:
    rig = idle()
    rig.tick(20.0)
    return rig


def moving() -> Rig:
    """Under way to the first angle away from home."""
    rig = waiting()
    for _ in range(3):
        rig.window()
    while not (rig.state is S.MOVING and rig.machine.step == 1):
        rig.tick()
        if rig.state is S.MEASURING:
            rig.tick(2.0)
            rig.window()
    rig.angle = 60.0
    return rig


def settling() -> Rig:
    rig = moving()
    rig.angle = 40.0
    rig.tick()
    return rig


def measuring() -> Rig:
    rig = settling()
    rig.ticks(0.6)
    return rig


def returning() -> Rig:
    rig = measuring()
    rig.machine.abort(rig.now)
    rig.tick()
    return rig


def aborted() -> Rig:
    rig = returning()
    rig.angle = HOME
    rig.tick()
    return rig


def complete() -> Rig:
    """All steps measured; the owner has not said yet what they led to."""
    rig = waiting()
    for _ in range(3):
        rig.window()
    for _ in range(4000):
        rig.follow()
        if rig.state is S.MEASURING:
            rig.tick(2.0)
            rig.window()
        if rig.machine.completed:
            return rig
    raise AssertionError("the sweep did not complete")


def updated() -> Rig:
    rig = complete()
    rig.machine.finish(rig.now, updated=True)
    return rig


def not_learned() -> Rig:
    rig = complete()
    rig.machine.finish(rig.now, updated=False)
    return rig


STARTS: dict[SweepState, Callable[[], Rig]] = {
    S.IDLE: idle,
    S.WAITING: waiting,
    S.MOVING: moving,
    S.SETTLING: settling,
    S.MEASURING: measuring,
    S.RETURNING: returning,
    S.ABORTED: aborted,
    S.UPDATED: updated,
    S.NOT_LEARNED: not_learned,
}


@pytest.mark.parametrize("state", STARTS)
def test_every_state_can_be_reached(state: SweepState) -> None:
    assert STARTS[state]().state is state


def put(**change: object) -> Callable[[Rig], None]:
    """Change the rig and let a tick pass."""

    def act(rig: Rig) -> None:
        for name, value in change.items():
            setattr(rig, name, value)
        rig.tick()

    return act


def window(**change: object) -> Callable[[Rig], None]:
    """A window closes."""
    return lambda rig: rig.window(**change)


def later(seconds: float) -> Callable[[Rig], None]:
    """Time passes, tick by tick."""
    return lambda rig: rig.ticks(seconds)


def steady(rig: Rig) -> None:
    for _ in range(3):
        rig.window()
    rig.tick()


def abort(rig: Rig) -> None:
    rig.machine.abort(rig.now)


def lie(rig: Rig) -> None:
    rig.machine.abort(rig.now, SweepAbort.FORCE_DOES_NOT_FOLLOW)


def request(rig: Rig) -> None:
    rig.machine.request()
    rig.tick()


A = SweepAbort
TRANSITIONS = [
    # from, what happens, to, reason of the abort
    (S.IDLE, later(5.0), S.IDLE, None),
    (S.IDLE, later(21.0), S.WAITING, None),
    (S.IDLE, request, S.WAITING, None),
    (S.IDLE, abort, S.IDLE, None),
    (S.WAITING, later(100.0), S.WAITING, None),
    (S.WAITING, steady, S.MOVING, None),
    (S.WAITING, abort, S.IDLE, None),
    (S.MOVING, later(2.0), S.MOVING, None),
    (S.MOVING, put(angle=40.3), S.SETTLING, None),
    (S.MOVING, later(5.0), S.RETURNING, A.NOT_FOLLOWING),
    (S.MOVING, put(angle=NAN), S.RETURNING, A.FEEDBACK_STALE),
    (S.MOVING, put(actuator=ActuatorState.FAULT), S.RETURNING, A.ACTUATOR_FAULT),
    (S.MOVING, put(actuator=ActuatorState.MANUAL), S.ABORTED, A.MANUAL),
    (S.MOVING, window(flow_kg_s=NAN), S.RETURNING, A.NOT_MEASURED),
    (S.MOVING, window(speed_rad_s=38.0), S.RETURNING, A.SPEED_CHANGED),
    (S.MOVING, window(still=False), S.MOVING, None),
    (S.MOVING, abort, S.RETURNING, A.OPERATOR),
    (S.SETTLING, later(0.6), S.MEASURING, None),
    (S.SETTLING, put(actuator=ActuatorState.MOVING), S.SETTLING, None),
    (S.SETTLING, put(angle=45.0), S.SETTLING, None),
    (S.SETTLING, lambda rig: (put(angle=45.0)(rig), later(7.0)(rig)), S.RETURNING, A.NOT_SETTLING),
    (S.SETTLING, put(angle=NAN), S.RETURNING, A.FEEDBACK_STALE),
    (S.SETTLING, put(actuator=ActuatorState.MANUAL), S.ABORTED, A.MANUAL),
    (S.SETTLING, window(flow_kg_s=NAN), S.RETURNING, A.NOT_MEASURED),
    (S.SETTLING, abort, S.RETURNING, A.OPERATOR),
    (S.MEASURING, lambda rig: (rig.tick(1.5), rig.window()), S.MEASURING, None),
    (S.MEASURING, lambda rig: (rig.tick(1.5), rig.window(), rig.window()), S.MOVING, None),
    (S.MEASURING, window(), S.MEASURING, None),
    (S.MEASURING, put(angle=45.0), S.SETTLING, None),
    (S.MEASURING, later(13.0), S.RETURNING, A.NOT_SETTLING),
    (S.MEASURING, lambda rig: (rig.tick(1.5), rig.window(flow_kg_s=20.0)), S.RETURNING, A.FLOW_CHANGED),
    (S.MEASURING, window(speed_rad_s=46.0), S.RETURNING, A.SPEED_CHANGED),
    (S.MEASURING, window(flow_kg_s=NAN), S.RETURNING, A.NOT_MEASURED),
    (S.MEASURING, put(angle=NAN), S.RETURNING, A.FEEDBACK_STALE),
    (S.MEASURING, put(actuator=ActuatorState.FAULT), S.RETURNING, A.ACTUATOR_FAULT),
    (S.MEASURING, abort, S.RETURNING, A.OPERATOR),
    (S.RETURNING, later(5.0), S.RETURNING, A.OPERATOR),
    (S.RETURNING, put(angle=HOME), S.ABORTED, A.OPERATOR),
    (S.RETURNING, later(11.0), S.ABORTED, A.OPERATOR),
    (S.RETURNING, put(angle=NAN), S.RETURNING, A.OPERATOR),
    (S.RETURNING, put(actuator=ActuatorState.MANUAL), S.ABORTED, A.OPERATOR),
    (S.RETURNING, abort, S.RETURNING, A.OPERATOR),
    (S.ABORTED, later(50.0), S.ABORTED, A.OPERATOR),
    (S.ABORTED, later(61.0), S.WAITING, A.OPERATOR),
    (S.ABORTED, request, S.WAITING, A.OPERATOR),
    (S.UPDATED, later(100.0), S.UPDATED, None),
    (S.UPDATED, lambda rig: rig.tick(1801.0), S.WAITING, None),
    (S.UPDATED, lambda rig: (put(angle=50.0)(rig), later(4.0)(rig)), S.RETURNING, None),
    (S.UPDATED, lambda rig: (put(angle=50.0)(rig), later(4.0)(rig), put(angle=HOME)(rig)), S.IDLE, None),
    (S.NOT_LEARNED, lambda rig: rig.tick(1801.0), S.WAITING, None),
    (S.NOT_LEARNED, lie, S.NOT_LEARNED, None),
]


@pytest.mark.parametrize(("start", "event", "end", "reason"), TRANSITIONS)
def test_transition(start: SweepState, event: Callable[[Rig], object], end: SweepState, reason: SweepAbort | None) -> None:
    rig = STARTS[start]()
    event(rig)
    assert (rig.state, rig.machine.abort_reason) == (end, reason)


def test_the_table_leaves_no_state_out() -> None:
    assert {start for start, *_ in TRANSITIONS} == set(SweepState)
    assert {end for _, _, end, _ in TRANSITIONS} == set(SweepState)
    assert {reason for *_, reason in TRANSITIONS} >= set(SweepAbort) - {A.FORCE_DOES_NOT_FOLLOW}


@pytest.mark.parametrize("unfit", ["low flow", "unsteady", "not measured", "away", "manual", "speed"])
def test_a_sweep_waits_for_its_conditions(unfit: str) -> None:
    rig = waiting()
    for number in range(8):
        rig.flow = {"low flow": 3.0, "unsteady": 10.0 + 2.0 * (-1) ** number, "not measured": NAN}.get(unfit, 10.0)
        rig.angle = 66.0 if unfit == "away" else HOME
        rig.speed = 42.0 + 3.0 * (-1) ** number if unfit == "speed" else 42.0
        rig.window()
    rig.actuator = ActuatorState.MANUAL if unfit == "manual" else ActuatorState.IDLE
    rig.tick()
    assert rig.state is S.WAITING
    assert rig.demand is None


def test_off_schedule_only_a_sweep_that_is_asked_for_begins() -> None:
    rig = idle()
    rig.machine.schedule.by_schedule = False
    rig.tick(20.0)
    assert rig.state is S.IDLE
    rig.machine.request()
    rig.tick()
    assert rig.state is S.WAITING


@pytest.mark.parametrize("start", [S.IDLE, S.WAITING, S.ABORTED, S.UPDATED, S.NOT_LEARNED])
def test_a_plate_at_rest_is_not_driven(start: SweepState) -> None:
    rig = STARTS[start]()
    rig.tick()
    assert not rig.machine.driving
    assert rig.demand is None


def test_the_sequence_is_bracketed_by_home() -> None:
    assert sweep_sequence((40.0, 55.0, 90.0), HOME, 2) == (HOME, 40.0, 55.0, HOME, 90.0, HOME)
    assert sweep_sequence((40.0, 55.0), HOME, 1) == (HOME, 40.0, HOME, 55.0, HOME)


def test_each_step_counts_its_windows_and_no_other() -> None:
    rig = measuring()
    rig.window()
    assert rig.step == -1, "began before the plate had settled"
    rig.tick(1.5)
    for change in ({"still": False}, {"whole": False}, {"trend": 9.0}):
        rig.window(**change)
        assert rig.step == -1
    rig.window()
    assert rig.step == 1
    rig.window()
    assert rig.step == 1
    rig.window()
    assert rig.step == -1


def test_waits_double_after_each_abort_and_not_beyond_the_interval() -> None:
    rig = Rig(replace(SETTINGS, interval_s=200.0))
    waits = []
    for _ in range(4):
        rig.machine.request()
        while not rig.machine.visiting:
            rig.window()
            rig.tick()
        rig.machine.abort(rig.now)
        waits.append(round(rig.machine.schedule.remaining_s(rig.now)))
        rig.angle = HOME
        rig.tick()
    assert waits == [60, 120, 200, 200]


def test_a_hand_on_the_plate_is_not_fought_and_the_plate_goes_home_after() -> None:
    rig = measuring()
    rig.actuator = ActuatorState.MANUAL
    for _ in range(300):
        rig.tick()
        assert rig.demand is None or rig.demand.mode is CommandMode.RELEASE
    assert rig.state is S.ABORTED
    rig.actuator = ActuatorState.IDLE
    rig.ticks(4.0)
    assert rig.demand == PlateDemand(CommandMode.GO_HOME)


def test_a_plate_found_away_from_home_at_the_start_is_taken_home() -> None:
    rig = Rig()
    rig.angle = 40.0
    rig.ticks(4.0)
    assert rig.demand == PlateDemand(CommandMode.GO_HOME)
    rig.angle = HOME
    rig.tick()
    assert rig.state is S.IDLE


def test_a_plate_that_never_moved_is_found_out() -> None:
    rig = waiting()
    steady(rig)
    machine = rig.machine
    while not machine.completed:
        rig.follow()
        if rig.state is S.MEASURING:
            rig.tick(2.0)
            rig.window(flow_kg_s=10.0 * (1.0 + 0.01 * (HOME - rig.angle)), force_n=40.0)
    assert machine.implausible_feedback()
    machine.abort(rig.now, SweepAbort.FORCE_DOES_NOT_FOLLOW)
    rig.tick()
    assert (rig.state, machine.abort_reason, machine.not_following) == (S.ABORTED, A.FORCE_DOES_NOT_FOLLOW, True)


def test_a_plate_with_true_feedback_is_plausible() -> None:
    assert not complete().machine.implausible_feedback()


def test_disabled_sweeps_never_start_by_themselves() -> None:
    rig = Rig(replace(SETTINGS, enabled=False))
    for _ in range(3):
        rig.window()
    rig.tick(10_000.0)
    assert rig.state is S.IDLE


def test_progress_runs_from_0_to_100() -> None:
    rig = waiting()
    steady(rig)
    seen = [rig.machine.progress_pct]
    while not rig.machine.completed:
        rig.follow()
        if rig.state is S.MEASURING:
            rig.tick(2.0)
            rig.window()
        seen.append(rig.machine.progress_pct)
    rig.machine.finish(rig.now, updated=True)
    assert seen == sorted(seen)
    assert seen[0] == 0.0
    assert rig.machine.progress_pct == 100.0


@pytest.mark.parametrize(("speed_rpm", "begins_s"), [(400.0, 99.8355), (60.0, 99.5), (0.0, 99.5)])
def test_a_window_reaches_back_by_a_pattern_of_the_chain_at_most(speed_rpm: float, begins_s: float) -> None:
    """At 400 rpm and a pitch radius of 54.1 mm the chain makes 2.27 m/s: a pattern of two paddles, 0.3727 m, in 164 ms."""
    window = SimpleNamespace(start_s=100.0, speed_rad_s=speed_rpm * RPM)
    assert support_start_s(window, MACHINE, 0.5) == pytest.approx(begins_s, abs=1e-4)  # type: ignore[arg-type]
