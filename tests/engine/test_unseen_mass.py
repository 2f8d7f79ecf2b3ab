"""Grain that passes while sensor or speed is silent is in no load: the standard deviation says how much that may be."""

from __future__ import annotations

import json

import pytest
from engine_bench import Bench, Kept, monitor

from yieldmon import frames as bus
from yieldmon.engine.mass.unseen import FlowAtStop, UnseenMass
from yieldmon.engine.state import EngineState

SAMPLES, SPEED = (bus.IMPACT_SENSOR_SAMPLES,), (bus.ELEVATOR_SPEED,)
ALL = (bus.IMPACT_SENSOR_SAMPLES, bus.ELEVATOR_SPEED, bus.PLATE_ACTUATOR_FEEDBACK)
FLOW_KG_S, FULL_S, END_S = 10.0, 15.0, 100.0

#: What is silent, from when to when, s, how often, every 10 s; kg that pass unseen.
SILENCES = {
    "nothing": ((), 0.0, 0.0, 1, 0.0),
    "the sensor": (SAMPLES, 40.0, 60.0, 1, 200.0),
    "the speed": (SPEED, 40.0, 60.0, 1, 200.0),
    "the bus": (ALL, 40.0, 60.0, 1, 200.0),
    "the sensor, again and again": (SAMPLES, 30.0, 33.0, 5, 150.0),
    "the sensor, until the grain has ended": (SAMPLES, 70.0, 90.0, 1, 100.0),
    "the sensor, without grain": (SAMPLES, 85.0, 92.0, 1, 0.0),
}


@pytest.mark.parametrize("silence", SILENCES)
def test_what_may_have_passed_unseen_is_in_the_standard_deviation(silence: str) -> None:
    silent, from_s, to_s, times, unseen_kg = SILENCES[silence]
    bench = Bench(flow=lambda t: FLOW_KG_S if FULL_S < t - 1000.0 < 80.0 else 0.0)

    def lost(time_s: float) -> bool:
        return any(from_s <= time_s - 1000.0 - n * 10.0 < to_s for n in range(times))

    target = monitor()
    for frame in bench.frames(END_S):
        if not (frame.message in silent and lost(frame.time_s)):
            target.feed(frame)
    load, whole = target.start_load()[0].load, monitor()
    for frame in bench.frames(END_S):
        whole.feed(frame)
    seen_through = whole.start_load()[0].load
    missing_kg = seen_through.measured_kg - load.measured_kg
    wider_kg = (load.std_dev_kg**2 - seen_through.std_dev_kg**2) ** 0.5 if load.std_dev_kg > seen_through.std_dev_kg else 0.0
    assert missing_kg == pytest.approx(unseen_kg, abs=25.0)
    # With a second at either end, of which a part was seen; without grain after it half of the flow before.
    assert 0.97 * missing_kg - 1.0 < wider_kg < 1.3 * missing_kg + 15.0
    assert target.totals.total_budget.std_dev_kg == pytest.approx(load.std_dev_kg)


def test_a_new_load_does_not_have_what_the_load_before_may_be_missing() -> None:
    target = monitor()
    for frame in Bench(flow=lambda t: FLOW_KG_S if t > 1000.0 + FULL_S else 0.0).frames(END_S):
        if frame.message not in SAMPLES or not 40.0 <= frame.time_s - 1000.0 < 60.0:
            target.feed(frame)
        if target.loads[-1].number == 1 and frame.time_s > 1055.0:
            target.start_load()
    first, second = target.loads
    assert first.std_dev_kg == pytest.approx(140.0, rel=0.2)
    assert second.std_dev_kg == pytest.approx(60.0, rel=0.2)


#: When a run ends and the next begins, s, with grain from 15 to 80 s; what the clock is set on by meanwhile; kg that pass unseen.
STOPS = {
    "in grain": (40.0, 60.0, 0.0, 200.0),
    "before grain": (10.0, 25.0, 0.0, 0.0),
    "after grain": (70.0, 95.0, 0.0, 0.0),
    "the clock is set back": (40.0, 60.0, -300.0, 0.0),
    "the clock is set on by years": (40.0, 60.0, 1e9, 3600.0 * FLOW_KG_S),
}


@pytest.mark.parametrize("stop", STOPS)
def test_what_may_have_passed_while_the_program_was_stopped_is_in_the_standard_deviation(stop: str) -> None:
    until_s, from_s, set_on_s, unseen_kg = STOPS[stop]
    frames = Bench(flow=lambda t: FLOW_KG_S if FULL_S < t - 1000.0 < 80.0 else 0.0).frames(END_S)
    before, after = monitor(), monitor()
    for frame in frames:
        if frame.time_s - 1000.0 < until_s:
            before.feed(frame)
    kept = before.snapshot()
    after.restore(EngineState.from_dict(json.loads(json.dumps(kept.as_dict()))))
    for frame in frames:
        if frame.time_s - 1000.0 >= from_s:
            after.feed(frame._replace(time_s=frame.time_s + set_on_s))
    found, noise_kg = after.totals.load_budget, 10.0
    assert found.noise_kg2**0.5 == pytest.approx(unseen_kg, rel=0.1, abs=noise_kg)
    assert after.totals.total_budget.noise_kg2 == pytest.approx(found.noise_kg2)


def gone_on(before: Kept, *, starts: int = 1) -> Kept:
    """From the state of the one before, after so many starts."""
    for _ in range(starts):
        kept, before = before.snapshot(), monitor()
        before.restore(EngineState.from_dict(json.loads(json.dumps(kept.as_dict()))))
    return before


#: When the sensor is silent, from and to, s; when a run ends; s until the next begins, 0: a reload; how many starts that takes;
#: kg that pass unseen.
SEVERAL = {
    "a reload while the sensor is silent": (((40.0, 60.0),), (50.0,), 0.0, 1, 200.0),
    "two reloads at once": (((40.0, 60.0),), (50.0,), 0.0, 2, 200.0),
    "a stop while the sensor is silent": (((40.0, 60.0),), (47.0,), 5.0, 1, 200.0),
    "a reload between two silences": (((25.0, 45.0), (55.0, 75.0)), (50.0,), 0.0, 1, 400.0),
    "stop after stop": ((), (30.0, 40.0, 50.0, 60.0), 5.0, 1, 240.0),
    "a stop that takes two starts": ((), (40.0,), 20.0, 2, 205.0),
}


@pytest.mark.parametrize("several", SEVERAL)
def test_what_may_have_passed_unseen_outlives_stops_and_reloads(several: str) -> None:
    silences, ends_s, gap_s, starts, unseen_kg = SEVERAL[several]
    target, left = monitor(), list(ends_s)
    for frame in Bench(flow=lambda t: FLOW_KG_S if t > 1000.0 + FULL_S else 0.0).frames(80.0):
        at_s = frame.time_s - 1000.0
        if left and at_s >= left[0]:
            left.pop(0)
            target = gone_on(target, starts=starts)
        stopped = any(end_s <= at_s < end_s + gap_s for end_s in ends_s)
        silent = frame.message in SAMPLES and any(from_s <= at_s < to_s for from_s, to_s in silences)
        if not (stopped or silent):
            target.feed(frame)
    assert target.totals.load_budget.noise_kg2**0.5 == pytest.approx(unseen_kg, rel=0.1)
    assert target.totals.total_budget.noise_kg2 == pytest.approx(target.totals.load_budget.noise_kg2)


def test_grain_that_a_suspect_zero_hides_is_in_the_standard_deviation_after_a_reload() -> None:
    target, kept = monitor(), list[float]()
    for frame in Bench(flow=lambda t: FLOW_KG_S if t > 1000.0 + FULL_S else 0.0, noise_mv=2.0).frames(END_S):
        target.feed(frame)
        if not kept and frame.time_s > 1030.0:
            target.calibrate_zero(despite_signs=True)
            kept.append(0.0)
        if len(kept) == 1 and frame.time_s > 1060.0:
            kept.append(target.totals.load_budget.zero_kg)
            target = gone_on(target)
    assert kept[1] > 100.0
    assert target.totals.load_budget.zero_kg - kept[1] == pytest.approx(FLOW_KG_S * (END_S - 60.0), rel=0.05)


def test_a_state_of_before_has_no_flow_at_its_end() -> None:
    document = monitor().snapshot().as_dict()
    assert document.pop("at_stop") is None
    assert EngineState.from_dict(document).at_stop is None


@pytest.mark.parametrize("hours", [0.05, 8.0])
def test_a_machine_that_is_switched_off_in_grain_missed_nothing(hours: float) -> None:
    """The computer may go on; the elevator is empty afterwards."""
    bench, target = Bench(flow=lambda t: FLOW_KG_S if FULL_S < t - 1000.0 < 40.0 else 0.0), monitor()
    for frame in bench.frames(40.0):
        target.feed(frame)
    before = target.totals
    off_s = 1e3 * round(3.6 * hours, 2)
    for at in range(60):
        target.tick(1040.0 + off_s * (at + 1) / 60.0)
    for frame in Bench(flow=lambda t: 0.0).frames(20.0):
        target.feed(frame._replace(time_s=frame.time_s + 40.0 + off_s))
    assert target.totals.load_kg == pytest.approx(before.load_kg, rel=0.05)
    assert target.totals.load_budget.std_dev_kg < before.load_budget.std_dev_kg + FLOW_KG_S


#: Seconds that are not measured, after a flow of 10 kg/s: how many, whether no grain can have come in them, whether the bus is
#: silent; then a flow, kg/s, and whether it shows that none can have come; kg that may have.
GAPS = {
    "no speed": ([(5.0, False, False)], (4.0, True), 35.0),
    "the elevator stands": ([(5.0, True, False)], (4.0, True), 0.0),
    "the elevator stands, and grain comes at once": ([(5.0, True, False)], (4.0, False), 35.0),
    "no speed, then the elevator stands": ([(5.0, False, False), (5.0, True, False)], (4.0, True), 70.0),
    "a silent bus of a minute": ([(30.0, False, True)] * 2, (4.0, False), 420.0),
    "a silent bus of more than a minute": ([(30.0, False, True), (31.0, False, True)], (4.0, False), 244.0),
    "and on": ([(61.0, False, True), (10.0, False, True)], (4.0, True), 284.0),
    "no sensor for more than a minute": ([(61.0, False, False)], (4.0, True), 427.0),
}


@pytest.mark.parametrize("gap", GAPS)
def test_what_a_gap_may_hold_by_what_was_silent(gap: str) -> None:
    missing, (then_kg_s, whole), unseen_kg = GAPS[gap]
    unseen = UnseenMass.since(FlowAtStop(1000.0, 10.0))
    for seconds, none, silent in missing:
        unseen.missing(seconds, whole=none, silent=silent)
    assert unseen.measured(then_kg_s, whole=whole) == pytest.approx(unseen_kg)
    assert unseen.measured(then_kg_s) == 0.0


@pytest.mark.parametrize(
    ("stopped_s", "again_s", "unseen_kg"), [(1.9, 0.0, 0.0), (2.0, 0.0, 8.0), (20.0, 5.0, 100.0), (20.0, 1e6, 14400.0)]
)
def test_what_stops_may_hold_adds_up_to_an_hour_of_the_smaller_flow(stopped_s: float, again_s: float, unseen_kg: float) -> None:
    first = UnseenMass.since(FlowAtStop(1000.0, 10.0))
    first.resume(stopped_s)
    second = UnseenMass.since(first.at_stop(1000.0))
    second.resume(again_s)
    assert second.measured(4.0) == pytest.approx(unseen_kg)


@pytest.mark.parametrize(("none", "unseen_kg"), [(False, 50.0), (True, 0.0)])
def test_a_load_that_ends_in_a_gap_may_lack_the_flow_before(none: bool, unseen_kg: float) -> None:
    unseen = UnseenMass.since(FlowAtStop(1000.0, 10.0))
    unseen.missing(5.0, whole=none)
    assert unseen.cut() == pytest.approx(unseen_kg)
    unseen.missing(5.0, whole=False)
    assert unseen.measured(4.0) == pytest.approx(35.0)
