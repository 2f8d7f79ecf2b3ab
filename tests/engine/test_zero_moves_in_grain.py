"""A zero that moves while grain flows: said where the pulses contradict it, or once the plate is seen empty; what was measured by
it is as unsure as it is wrong."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace

import pytest
from engine_bench import ZERO_MV, Bench, Kept, feed, monitor

from yieldmon.engine.mass.budget import FlowBudget
from yieldmon.engine.mass.load_summary import LoadRestated
from yieldmon.engine.mass.since_empty import SinceEmpty
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import events_in
from yieldmon.engine.state import EngineState
from yieldmon.physics.machine import Machine

EMPTY_S, STEP_S, GRAIN_ENDS_S, SECONDS = 15.0, 60.0, 110.0, 130.0
Course = Callable[[float], float]


def harvest(flow_kg_s: float) -> Course:
    return lambda time_s: flow_kg_s if EMPTY_S <= time_s - 1000.0 < GRAIN_ENDS_S else 0.0


def stepping(step_mv: float) -> Course:
    return lambda time_s: ZERO_MV + step_mv * (time_s - 1000.0 >= STEP_S)


def drifting(mv_per_h: float) -> Course:
    return lambda time_s: ZERO_MV + mv_per_h / 3600.0 * (time_s - 1000.0)


def bench(flow: Course, zero: Course = lambda time_s: ZERO_MV, seed: int = 1, **more: object) -> Bench:
    return Bench(flow=flow, zero=zero, scatter=0.07, noise_mv=3.0, paddle_vibration_mv=4.0, seed=seed, **more)  # type: ignore[arg-type]


def measured(source: Bench, at_s: float = SECONDS, command: Callable[[Monitor], object] = lambda target: None) -> Kept:
    """A monitor that got the command at at_s."""
    target, run = monitor(), source.frames(SECONDS)
    feed(target, [frame for frame in run if frame.time_s < 1000.0 + at_s])
    command(target)
    feed(target, [frame for frame in run if frame.time_s >= 1000.0 + at_s])
    return target


def shown(kept: Kept) -> list[tuple[float, str]]:
    """When ZeroDrifted was shown, and what it said."""
    return [(event.time_s - 1000.0, event.detail) for event in kept.fault_events if event.code == "ZeroDrifted" and event.active]


@pytest.mark.parametrize("flow_kg_s", [4.0, 10.0, 20.0])
@pytest.mark.parametrize("step_mv", [30.0, -30.0])
def test_a_step_of_the_zero_in_grain_is_said_and_widens_the_flow(flow_kg_s: float, step_mv: float) -> None:
    kept = measured(bench(harvest(flow_kg_s), stepping(step_mv)))
    (at_s, detail), *_ = shown(kept)
    assert STEP_S < at_s < STEP_S + 10.0
    assert detail.startswith(f"the signal has stepped by {step_mv / 10.0:+.0f}"[:-1])
    assert detail.endswith("but the pulses of the grain have not changed")
    after = [record for record in kept.records if STEP_S + 10.0 < record.time_s - 1000.0 < GRAIN_ENDS_S]
    assert max(abs(record.mass_flow_kg_s - flow_kg_s) / record.std_dev_kg_s for record in after) < 2.0


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(
    "zero",
    [stepping(30.0), stepping(-30.0), stepping(7.0), drifting(200.0), drifting(-200.0)],
    ids=["30", "-30", "7", "up", "down"],
)
@pytest.mark.parametrize(
    ("at_s", "command"),
    [
        pytest.param(SECONDS, lambda target: None, id="open load"),
        pytest.param(GRAIN_ENDS_S + 1.5, Monitor.start_load, id="closed load"),
        pytest.param(GRAIN_ENDS_S + 1.5, Monitor.stop_load, id="no load any more"),
    ],
)
def test_once_the_plate_is_seen_empty_the_load_is_as_unsure_as_its_zero_was_wrong(
    zero: Course, at_s: float, command: Callable[[Monitor], object], seed: int
) -> None:
    kept = measured(bench(harvest(10.0), zero, seed), at_s, command)
    load = kept.loads[0]
    true_kg = 10.0 * (GRAIN_ENDS_S - EMPTY_S)
    assert abs(load.measured_kg - true_kg) > 5.0
    assert abs(load.measured_kg - true_kg) < 2.0 * load.std_dev_kg
    assert kept.totals.total_budget.std_dev_kg >= 0.95 * load.std_dev_kg


def test_mass_that_belongs_to_no_load_widens_the_totals() -> None:
    kept = measured(bench(harvest(10.0), stepping(30.0)), 5.0, Monitor.stop_load)
    true_kg = 10.0 * (GRAIN_ENDS_S - EMPTY_S)
    assert abs(kept.totals.total_kg - true_kg) < 2.0 * kept.totals.total_budget.std_dev_kg


RESTART_S = 100.0
CLOSED: dict[str, Callable[[Monitor], object]] = {
    "open load": lambda target: None,
    "closed load": Monitor.start_load,
    "no load any more": Monitor.stop_load,
}


def restarted(source: Bench, command: Callable[[Monitor], object], *, version: int = 0) -> tuple[Kept, Kept]:
    """A monitor that is not restarted, and one that goes on from its state at RESTART_S. version: added to that of the
    parameters in the state."""
    whole, after, run = monitor(), monitor(), source.frames(SECONDS)
    feed(whole, [frame for frame in run if frame.time_s < 1000.0 + RESTART_S])
    command(whole)
    state = EngineState.from_dict(json.loads(json.dumps(whole.snapshot().as_dict(), allow_nan=False)))
    after.restore(replace(state, parameter_version=state.parameter_version + version))
    for one in (whole, after):
        feed(one, [frame for frame in run if frame.time_s >= 1000.0 + RESTART_S])
    return whole, after


def restated_numbers(kept: Kept) -> list[int]:
    return [event.number for event in events_in(kept.results) if isinstance(event, LoadRestated)]


@pytest.mark.parametrize(
    ("name", "version", "restated"),
    [("open load", 0, []), ("closed load", 0, [1]), ("no load any more", 0, [1]), ("closed load", 1, [])],
)
def test_a_zero_that_moved_before_a_restart_widens_what_was_measured_before_it(
    name: str, version: int, restated: list[int]
) -> None:
    """Closed loads measured with other parameters keep what was stated of them."""
    whole, after = restarted(bench(harvest(10.0), drifting(600.0)), CLOSED[name], version=version)
    assert after.totals.total_budget.zero_kg == pytest.approx(whole.totals.total_budget.zero_kg, rel=0.1)
    assert after.totals.load_budget.zero_kg == pytest.approx(whole.totals.load_budget.zero_kg, rel=0.1)
    assert restated_numbers(after) == restated
    assert whole.totals.total_budget.zero_kg > 50.0


def test_a_restart_widens_nothing_by_a_zero_that_stays() -> None:
    _, after = restarted(bench(harvest(10.0)), CLOSED["closed load"])
    assert restated_numbers(after) == []


def test_loads_that_are_not_known_after_a_restart_widen_the_total() -> None:
    """A restart knows the newest dozen of loads."""
    target, run = monitor(), bench(harvest(10.0), stepping(30.0)).frames(SECONDS)
    for start_s in range(1000, 1100, 5):
        feed(target, [frame for frame in run if start_s <= frame.time_s < start_s + 5])
        target.start_load()
    after = monitor()
    after.restore(target.snapshot())
    for one in (target, after):
        feed(one, [frame for frame in run if frame.time_s >= 1100.0])
    assert after.totals.total_budget.zero_kg == pytest.approx(target.totals.total_budget.zero_kg, rel=0.02)


def test_mass_of_no_load_before_a_reset_is_in_no_total() -> None:
    source = bench(harvest(10.0), stepping(30.0))
    run = source.frames(SECONDS)
    targets = monitor(), monitor()
    for target, stop_s in zip(targets, (20.0, 100.0), strict=True):
        feed(target, [frame for frame in run if frame.time_s < 1000.0 + stop_s])
        target.stop_load()
        feed(target, [frame for frame in run if 1000.0 + stop_s <= frame.time_s < 1105.0])
        target.reset_totals()
        feed(target, [frame for frame in run if frame.time_s >= 1105.0])
    assert targets[0].totals == targets[1].totals


@pytest.mark.parametrize("mv_per_h", [600.0, -600.0])
def test_a_zero_that_moved_by_too_much_for_drift_is_said_with_the_time_it_concerns(mv_per_h: float) -> None:
    """Too slowly for the pulses to show it as a step."""
    (at_s, detail), *_ = shown(measured(bench(harvest(20.0), drifting(mv_per_h))))
    assert GRAIN_ENDS_S < at_s < GRAIN_ENDS_S + 15.0
    expected = r"the empty elevator reads {}1[5-9] mV from the zero with which the flow of the last 1\d\d s was measured"
    assert re.fullmatch(expected.format(re.escape("+" if mv_per_h > 0.0 else "-")), detail)


def wave(time_s: float) -> float:
    return harvest(10.0)(time_s) * (1.0 + 0.5 * ((time_s // 20.0) % 2.0))


UNDISTURBED: dict[str, Bench] = {
    "steady": bench(harvest(10.0)),
    "a step of the flow": bench(lambda time_s: harvest(6.0 if time_s < 1060.0 else 18.0)(time_s)),
    "steps up and down": bench(wave),
    "a ramp": bench(lambda time_s: harvest(0.2 * (time_s - 1000.0))(time_s)),
    "grain in bursts": bench(lambda time_s: harvest(10.0)(time_s) * (1.0 if time_s % 2.0 < 1.3 else 0.05)),
    "another speed": bench(harvest(10.0), rpm=lambda time_s: 400.0 if time_s < 1060.0 else 380.0),
    "broad pulses": bench(wave, pulse_std_dev_s=0.022),
    "a drift": bench(harvest(10.0), drifting(20.0)),
    "a plate that moves": bench(harvest(10.0), angle=lambda time_s: 70.0 - 25.0 * (1060.0 <= time_s < 1075.0)),
}


@pytest.mark.parametrize("case", UNDISTURBED)
def test_nothing_else_is_a_step_of_the_zero(case: str) -> None:
    assert shown(measured(UNDISTURBED[case])) == []


def test_a_step_that_goes_back_is_gone() -> None:
    course: Course = lambda time_s: ZERO_MV + 30.0 * (1060.0 <= time_s < 1080.0)  # noqa: E731
    kept = measured(bench(harvest(10.0), course))
    assert [event.active for event in kept.fault_events if event.code == "ZeroDrifted"] == [True, False]


def test_what_the_zero_made_of_the_mass_is_what_was_not_counted_yet() -> None:
    since, gain = SinceEmpty(), Machine().sensor.gain_n_per_mv
    budget = FlowBudget(noise_kg_s=0.1, parameters_kg_s=0.1, zero_kg_s=0.02, per_error_kg_s=10.0)
    for _ in range(100):
        since.add(3, budget, 40.0, 1.0)
    since.add(4, budget, 40.0, 10.0)
    since.add(5, budget, 0.0, 10.0)
    found = since.seen_empty(30.0 * gain)
    # 0.25 kg/s a newton.
    assert found == pytest.approx({3: 100.0 * (0.25 * 30.0 * gain - 0.02), 4: 10.0 * (0.25 * 30.0 * gain - 0.02)})
    assert since.seen_empty(30.0 * gain) == {}
