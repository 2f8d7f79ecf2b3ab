"""A log's sweeps: learnt from where the plate made them, and no fault about commands that nobody sent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache

import pytest
from engine_bench import HOME_DEG, Actuator, Kept, feed, monitor, only, run_with_actuator
from test_engine_runs import Recorded, assert_same, cut
from test_engine_sweep_on_plate import BENCH, SETTINGS, SWEEP_S, SweepCalibrator

from studies.waveform.frame_runs import run_of
from yieldmon import frames as bus
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.results import events_in, frames_in
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sweeps.plate import SweepEnded
from yieldmon.engine.sweeps.sweep_inputs import SweepAbort
from yieldmon.frames import ActuatorState, Frame, SweepState

NOTHING_NEW = CalibrationOutcome(None, "nothing new")
ABOUT_COMMANDS = {FaultCode.PLATE_NOT_FOLLOWING, FaultCode.SWEEP_ABORTED}


@cache
def live(actuator: str = "", from_s: float = 0.0, to_s: float = float("inf")) -> tuple[list[Frame], Kept, SweepCalibrator]:
    """A live machine's frames, what its monitor made of them, and what its calibrator was given."""
    calibrator = SweepCalibrator(NOTHING_NEW)
    recorded = Recorded(monitor(SETTINGS, calibrator=calibrator))
    run_with_actuator(recorded, BENCH, Actuator(fault=actuator, fault_from_s=from_s, fault_to_s=to_s), SWEEP_S)  # type: ignore[arg-type]
    return recorded.frames, recorded.target, calibrator


@dataclass
class Log:
    """A bench whose plate went its own way. stops: (until time, s; angle, deg), the plate moving at 20 deg/s between."""

    stops: tuple[tuple[float, float], ...] = ()
    state: ActuatorState = ActuatorState.IDLE
    flow: Callable[[float], float] = field(default=BENCH.flow)

    def angle(self, time_s: float) -> float:
        """Where the plate is."""
        last_deg, since_s = HOME_DEG, 0.0
        for until_s, angle_deg in (*self.stops, (float("inf"), HOME_DEG)):
            if time_s < until_s:
                reach = 20.0 * (time_s - since_s)
                return last_deg + max(-reach, min(reach, angle_deg - last_deg))
            last_deg, since_s = angle_deg, until_s
        raise AssertionError("the last stop has no end")

    def frames(self, seconds: float) -> Iterator[Frame]:
        """What the bus carried."""
        for frame in replace(BENCH, angle=self.angle, flow=self.flow).frames(seconds):
            if frame.message == bus.PLATE_ACTUATOR_FEEDBACK:
                yield frame._replace(signals={**frame.signals, "ActuatorState": int(self.state)})
            else:
                yield frame


def followed(frames: list[Frame], settings: EngineSettings = SETTINGS) -> tuple[Kept, SweepCalibrator, list[SweepEnded]]:
    """A log's monitor, what its calibrator was given, and the sweeps that ended."""
    calibrator = SweepCalibrator(NOTHING_NEW)
    target = monitor(settings, calibrator=calibrator, drives_plate=False)
    out = frames_in(target.feed_run(run_of(frames)))
    assert only(out, bus.PLATE_ACTUATOR_COMMAND) == []
    return target, calibrator, [event for event in events_in(target.results) if isinstance(event, SweepEnded)]


def test_a_sweep_of_the_log_updates_from_the_same_windows_as_live() -> None:
    frames, _, given_live = live()
    target, given, ended = followed(frames)
    (live_windows,), (windows,) = given_live.given, given.given
    assert [w.time_s for w in windows] == [w.time_s for w in live_windows]
    assert [w.force_n for w in windows] == [w.force_n for w in live_windows]
    (end,) = ended
    assert (end.state, end.angles_deg) == (SweepState.NOT_LEARNED, (70.0, 40.0, 55.0, 70.0, 85.0, 90.0, 70.0))
    assert {event.code for event in target.fault_events} == set()


def test_a_log_is_stated_as_live_until_its_first_sweep_shows_something() -> None:
    frames, seen_live, _ = live()
    target, _, _ = followed(frames)
    first = next(k for k, record in enumerate(seen_live.records) if record.usable_for_calibration)
    stated = [
        [(r.mass_flow_kg_s, r.std_dev_kg_s, r.load_std_dev_kg, r.total_std_dev_kg) for r in of.records[: first + 1] if r.mass_kg]
        for of in (target, seen_live)
    ]
    assert stated[0] == stated[1]
    assert stated[0][-1][2] > 0.04 * seen_live.records[first].load_kg, "with what the sweep may show"


def test_one_by_one_and_in_runs_are_the_same_for_a_log_too() -> None:
    frames, _, _ = live()

    def fresh() -> Kept:
        return monitor(SETTINGS, calibrator=SweepCalibrator(NOTHING_NEW), drives_plate=False)

    one_by_one = fresh()
    feed(one_by_one, frames)
    assert_same(one_by_one, fresh(), iter([frames]))
    assert_same(one_by_one, fresh(), cut(frames, 5))


def test_a_plate_that_stays_at_home_is_no_fault() -> None:
    frames = list(Log().frames(60.0))
    live_on_it = monitor(SETTINGS)
    live_on_it.feed_run(run_of(frames))
    assert {event.code for event in live_on_it.fault_events} == ABOUT_COMMANDS  # the test can fail

    target, given, ended = followed(frames)
    assert target.fault_events == []
    assert (target.sweep.state, target.sweep.sweep_id, given.given, ended) == (SweepState.IDLE, 0, [], [])
    records = {r.operating_state for r in target.records if r.mass_kg > 0.0}
    assert records == {bus.OperatingState.HARVESTING}


VISITS = ((20.0, 70.0), (25.0, 45.0), (30.0, 60.0), (35.0, 90.0))
"""Times since the start, s, and angles."""


def visits(*stops: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    return tuple((BENCH.start_s + until_s, angle_deg) for until_s, angle_deg in stops)


def test_a_sweep_of_another_sequence_counts_once_the_plate_has_rested_at_home() -> None:
    target, given, ended = followed(list(Log(visits(*VISITS)).frames(55.0)))
    (windows,) = given.given
    assert target.sweep.sweep_id == 1
    assert ended[0].angles_deg == (70.0, 45.0, 60.0, 90.0, 70.0)
    angles = sorted({round(w.plate_angle_rad * 57.29577951308232) for w in windows})
    assert angles == [45, 60, 70, 90]
    assert all(w.plate_still for w in windows)
    assert target.fault_events == []


PASSED_OVER = [
    ("one other angle", Log(visits((20.0, 70.0), (30.0, 60.0)))),
    ("moved by hand", Log(visits(*VISITS), state=ActuatorState.MANUAL)),
    ("moved before the flow was steady", Log(visits((10.0, 70.0), *((t - 8.0, a) for t, a in VISITS[1:])))),
    ("moved with no grain", Log(visits(*VISITS), flow=lambda t: 0.0)),
]


@pytest.mark.parametrize("log", [log for _, log in PASSED_OVER], ids=[name for name, _ in PASSED_OVER])
def test_what_is_no_sweep_is_passed_over(log: Log) -> None:
    target, given, ended = followed(list(log.frames(55.0)))
    assert (given.given, ended) == ([], [])
    assert not ABOUT_COMMANDS & {event.code for event in target.fault_events}


def test_a_plate_that_stays_where_it_was_put_is_no_sweep() -> None:
    settings = replace(SETTINGS, sweep=replace(SETTINGS.sweep, measure_timeout_s=2.0))
    target, given, ended = followed(list(Log(visits((20.0, 70.0), (90.0, 60.0))).frames(50.0)), settings)
    assert (target.sweep.state, given.given, ended) == (SweepState.IDLE, [], [])


def test_sweeps_that_are_switched_off_update_nothing() -> None:
    frames, _, _ = live()
    off = EngineSettings(sweep=replace(SETTINGS.sweep, enabled=False))
    target, given, ended = followed(frames, off)
    assert (target.sweep.sweep_id, given.given, ended) == (0, [], [])


def test_a_sweep_cut_short_in_the_log_says_why_and_updates_nothing() -> None:
    log = Log(visits(*VISITS), flow=lambda t: 0.0 if t < 1004 else 10.0 if t < 1027 else 19.0)
    target, given, ended = followed(list(log.frames(55.0)))
    assert given.given == []
    assert [(end.state, end.reason) for end in ended] == [(SweepState.ABORTED, SweepAbort.FLOW_CHANGED.value)]
    assert {event.code for event in target.fault_events} == {FaultCode.SWEEP_ABORTED}


def test_feedback_that_the_force_contradicts_is_found_out_in_a_log_too() -> None:
    frames, seen_live, _ = live("lying")
    assert seen_live.sweep.abort_reason is SweepAbort.FORCE_DOES_NOT_FOLLOW
    target, given, ended = followed(frames)
    assert given.given == []
    assert [end.reason for end in ended] == [SweepAbort.FORCE_DOES_NOT_FOLLOW.value]
    assert set(target.faults.active) >= ABOUT_COMMANDS


def test_a_plate_that_stuck_live_is_in_a_log_a_plate_at_rest() -> None:
    frames, seen_live, _ = live("stuck", 1010.0)
    assert FaultCode.PLATE_NOT_FOLLOWING in {event.code for event in seen_live.fault_events}
    target, given, _ = followed(frames)
    assert (given.given, target.fault_events) == ([], [])
