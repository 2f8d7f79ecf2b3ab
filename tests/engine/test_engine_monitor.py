"""The monitor end to end on a pulse train with a known answer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from engine_bench import (
    MACHINE,
    N_PER_KG_S,
    Bench,
    ForceProportional,
    feed,
    flows,
    monitor,
    only,
    qualities,
    results,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from studies.waveform.frame_runs import run_of
from yieldmon import frames as bus
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import frames_in
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.settings import BudgetSettings, EngineSettings, ReferenceMassSettings
from yieldmon.engine.state import EngineState
from yieldmon.estimation.open_loop import FlowEstimate
from yieldmon.frames import NOT_AVAILABLE, EstimateQuality, Frame, OperatingState

Q = EstimateQuality


def harvest(start_s: float = 1005.0, end_s: float = 1e12, rate: float = 10.0) -> Callable[[float], float]:
    """Flow that begins and ends."""
    return lambda t: rate if start_s <= t < end_s else 0.0


STEADY = Bench(flow=harvest(), scatter=0.05, noise_mv=2.0, shaft_vibration_mv=5.0, paddle_vibration_mv=3.0)
STEADY_FRAMES = STEADY.frames(30)


def states(frames: list[Frame]) -> list[OperatingState]:
    return [OperatingState(f.signals["OperatingState"]) for f in only(frames, bus.YIELD_MONITOR_STATUS)]


def test_one_result_a_second_on_the_grid_of_bus_seconds() -> None:
    out = feed(monitor(), STEADY_FRAMES)
    for message in (bus.MASS_FLOW, bus.ACCUMULATED_MASS, bus.SELF_CALIBRATION_STATUS, bus.YIELD_MONITOR_STATUS):
        assert [f.time_s for f in only(out, message)] == pytest.approx([1001.1 + k for k in range(29)], abs=1e-9)
    counters = [f.signals["WindowCounter"] for f in only(out, bus.MASS_FLOW)]
    assert counters == list(range(1, 30))


def test_flow_and_mass_of_a_steady_harvest() -> None:
    target = monitor()
    out = feed(target, STEADY_FRAMES)
    found = np.array(flows(out))
    assert found[7:].mean() == pytest.approx(10.0, rel=0.01)
    assert qualities(out)[:4] == [Q.NOT_AVAILABLE, Q.NOT_AVAILABLE, Q.NOT_AVAILABLE, Q.NOT_HARVESTING]
    assert set(qualities(out)[5:]) == {Q.OK}
    assert states(out)[0] is OperatingState.ZEROING
    assert states(out)[-1] is OperatingState.HARVESTING
    assert target.totals.total_kg == pytest.approx(10.0 * 24.0, rel=0.01)
    assert target.faults.active == ()


NOISE_ALONE = replace(EngineSettings(), budget=BudgetSettings(0.0, 0.0, 0.0, 0.0))


def test_stated_standard_deviation_covers_the_error() -> None:
    bench = replace(STEADY, scatter=0.07, seed=3)
    target = monitor(NOISE_ALONE, estimator=ForceProportional(relative_std_dev=0.0))
    feed(target, bench.run(300))
    records = target.records[8:]
    scores = np.array([(r.mass_flow_kg_s - 10.0) / r.std_dev_kg_s for r in records])
    assert np.std(scores) == pytest.approx(1.0, abs=0.35)


def test_it_covers_the_error_of_seconds_of_which_most_is_lost() -> None:
    """Three quarters of each second in one piece: what is left is too short to show its own scatter."""
    bench = replace(STEADY, scatter=0.07, seed=3, drop=lambda i: i > 2500 and i % 250 >= 62)
    target = monitor(estimator=ForceProportional(relative_std_dev=0.0))
    feed(target, bench.run(150))
    records = target.records[14:]
    assert all(r.coverage == pytest.approx(0.25, abs=0.02) for r in records)
    scores = np.array([(r.force_n - 10.0 * N_PER_KG_S) / r.force_std_dev_n for r in records])
    assert np.std(scores) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize("seed", range(3))
def test_runs_of_any_length_give_the_same_bytes(seed: int) -> None:
    frames = replace(STEADY, drop=lambda i: i % 97 == 5, seed=seed + 20).frames(40)
    one_by_one = monitor()
    expected = feed(one_by_one, frames)
    target, out = monitor(), []
    generator = np.random.default_rng(seed)
    first = 0
    while first < len(frames):
        last = first + int(np.exp(generator.uniform(0.0, np.log(9000))))
        out += frames_in(target.feed_run(run_of(frames[first:last])))
        first = last
    assert repr(out) == repr(expected)
    assert repr(target.records) == repr(one_by_one.records)


def test_a_run_with_a_clock_jump_inside_gives_the_same_bytes() -> None:
    frames = [f if f.time_s < 1006.0 else f._replace(time_s=f.time_s - 3600.0) for f in STEADY.frames(10)]
    assert repr(monitor().feed_run(run_of(frames))) == repr(results(monitor(), frames))


JUMPS = [-7 * 3600.0, -1.0, 3600.0, 1e6]


@pytest.mark.parametrize("jump_s", JUMPS)
def test_a_clock_jump_costs_nothing(jump_s: float) -> None:
    at = 1012.3
    jumped = [f if f.time_s < at else f._replace(time_s=f.time_s + jump_s) for f in STEADY_FRAMES]
    plain, target = monitor(), monitor()
    expected, out = feed(plain, STEADY_FRAMES), feed(target, jumped)
    assert np.array(flows(out))[:29] == pytest.approx(np.array(flows(expected))[:29], rel=5e-3, nan_ok=True)
    assert target.totals.total_kg == pytest.approx(plain.totals.total_kg, rel=0.05)
    assert target.faults.occurrences(FaultCode.CLOCK_JUMPED) == 1
    assert [f.signals["WindowCounter"] for f in only(out, bus.MASS_FLOW)][:29] == list(range(1, 30))
    assert only(out, bus.MASS_FLOW)[28].time_s == pytest.approx(1029.1 + jump_s, abs=0.1)


def test_silence_is_not_available_and_totals_keep_what_was_measured() -> None:
    target = monitor()
    out = feed(target, STEADY_FRAMES)
    before = target.totals.total_kg
    out = [sent for second in range(1, 9) for sent in frames_in(target.tick(1030.0 + second))]
    assert set(qualities(out)[2:]) == {Q.NOT_AVAILABLE}
    assert all(math.isnan(rate) for rate in flows(out)[2:])
    # 0.9 s measured in a window that counts whole, and half a pattern left over, at the speed that was known then.
    assert target.totals.total_kg - before == pytest.approx(10.0, rel=0.08)
    assert [r.mass_kg > 0.0 for r in target.records[29:]] == [True, True, *[False] * (len(target.records) - 31)]
    # The speed of a shaft that nobody reports any more is not known.
    assert [math.isnan(r.elevator_speed_rad_s) for r in target.records[29:]] == [
        False,
        False,
        *[True] * (len(target.records) - 31),
    ]
    assert {FaultCode.SENSOR_MISSING, FaultCode.SPEED_MISSING, FaultCode.PLATE_FEEDBACK_STALE} <= set(target.faults.active)
    assert states(out)[-1] is OperatingState.FAULT


@pytest.mark.parametrize(
    ("lost", "expected", "mass_rel"),
    [
        (lambda i: 3000 <= i < 3050, Q.DEGRADED, 0.02),
        (lambda i: 3000 <= i < 3249 and i % 3 > 0, Q.DEGRADED, 0.02),
        (lambda i: 3000 <= i < 3240, Q.NOT_AVAILABLE, 0.1),
    ],
)
def test_lost_samples_degrade_their_second_and_are_filled(
    lost: Callable[[int], bool], expected: EstimateQuality, mass_rel: float
) -> None:
    whole, target = monitor(), monitor()
    feed(whole, STEADY_FRAMES)
    out = feed(target, replace(STEADY, drop=lost).run(30))
    assert expected in (qualities(out)[12], qualities(out)[13])
    assert set(qualities(out)[15:]) == {Q.OK}
    assert target.faults.occurrences(FaultCode.FRAMES_LOST) == 1
    assert target.totals.total_kg == pytest.approx(whole.totals.total_kg, rel=mass_rel)
    assert target.totals.total_kg <= whole.totals.total_kg * 1.005


@pytest.mark.parametrize("paused_s", [0.1, 0.3])
def test_a_sensor_that_pauses_is_reported_by_what_it_leaves_uncovered(paused_s: float) -> None:
    """By its counter no frame is missing, so how many are lost says nothing."""
    target = monitor()
    feed(target, [f._replace(time_s=f.time_s + paused_s) if f.time_s > 1012.5 else f for f in STEADY_FRAMES])
    begun = next(e for e in target.fault_events if e.code is FaultCode.FRAMES_LOST and e.active)
    (partly,) = (r for r in target.records if 0.0 < r.coverage < 0.98 and r.time_s > 1002.0)
    assert (partly.lost_frames, partly.coverage) == (0, pytest.approx(1.0 - paused_s, abs=0.01))
    assert begun.detail is not None
    assert begun.detail.startswith(f"samples for {100.0 * partly.coverage:.0f} % of the second, no frame missing")


@pytest.mark.parametrize(
    ("rate_hz", "told"), [(900.0, "samples for 90 % of the second, no"), (1200.0, "too many: a second sender, or")]
)
def test_a_sensor_of_another_sample_rate_than_is_configured_is_said_to_be_that(rate_hz: float, told: str) -> None:
    """Frames of four samples each, further apart or nearer than 1000 samples a second make them."""
    target, first_s = monitor(), STEADY_FRAMES[0].time_s
    frames = [
        f._replace(time_s=first_s + (f.time_s - first_s) * 1000.0 / rate_hz) if f.message == bus.IMPACT_SENSOR_SAMPLES else f
        for f in STEADY_FRAMES
    ]
    feed(target, sorted(frames, key=lambda f: f.time_s))
    details = [e.detail for e in target.fault_events if e.code is FaultCode.FRAMES_LOST and e.active]
    assert any(told in (detail or "") and "rate_hz" in (detail or "") for detail in details)


SAMPLES = frozenset({"Sample0", "Sample1", "Sample2", "Sample3"})


def without(message: str, first_s: float, last_s: float) -> list[Frame]:
    return [f for f in STEADY_FRAMES if f.message != message or not first_s <= f.time_s < last_s]


def test_missing_speed() -> None:
    target = monitor()
    out = feed(target, without(bus.ELEVATOR_SPEED, 1015.0, 1020.0))
    assert Q.NOT_AVAILABLE in qualities(out)[15:20]
    assert qualities(out)[-1] is Q.OK
    assert any(e.code is FaultCode.SPEED_MISSING for e in target.fault_events)
    assert FaultCode.SPEED_MISSING not in target.faults.active
    unknown = [math.isnan(record.elevator_speed_rad_s) for record in target.records]
    assert unknown[17:19] == [True, True]
    assert not any(unknown[:14] + unknown[22:])


def test_a_speed_that_no_frame_reported_is_not_the_machines_nominal_one() -> None:
    target = monitor()
    feed(target, without(bus.ELEVATOR_SPEED, 0.0, 1e9))
    assert all(math.isnan(record.elevator_speed_rad_s) for record in target.records)
    assert target.totals.total_kg == 0.0


def test_stale_feedback_of_a_plate_at_rest_degrades() -> None:
    target = monitor()
    out = feed(target, without(bus.PLATE_ACTUATOR_FEEDBACK, 1015.0, 1020.0))
    seen = target.records
    assert qualities(out)[15:19] == [Q.DEGRADED] * 4
    assert seen[17].std_dev_kg_s > seen[12].std_dev_kg_s
    assert qualities(out)[-1] is Q.OK


def test_feedback_that_never_came_leaves_the_angle_unknown() -> None:
    out = feed(monitor(), without(bus.PLATE_ACTUATOR_FEEDBACK, 0.0, 1e9))
    assert set(qualities(out)[5:]) == {Q.NOT_AVAILABLE}


@pytest.mark.parametrize("rpm", [0.0, 30.0, 249.0, 600.0, 900.0])
def test_elevator_outside_its_range_is_no_flow(rpm: float) -> None:
    bench = Bench(flow=harvest(1005.0, 1015.0), rpm=lambda t: 400.0 if t < 1018 else rpm)
    target = monitor()
    out = feed(target, bench.run(30))
    total = target.totals.total_kg
    assert set(qualities(out)[21:]) == {Q.NOT_HARVESTING}
    assert all(math.isnan(rate) for rate in flows(out)[21:])
    assert total == pytest.approx(100.0, rel=0.02)
    assert (FaultCode.SPEED_OUT_OF_RANGE in target.faults.active) == (rpm > 50.0)


def test_flow_at_a_speed_outside_the_range_is_not_available() -> None:
    bench = Bench(flow=harvest(), rpm=lambda t: 400.0 if t < 1018 else 240.0)
    out = feed(monitor(), bench.run(30))
    assert set(qualities(out)[21:]) == {Q.NOT_AVAILABLE}


def altered(change: dict[str, bus.Value]) -> list[Frame]:
    """STEADY with sample frames from 1015 s on changed."""
    out = []
    for frame in STEADY_FRAMES:
        if frame.message == bus.IMPACT_SENSOR_SAMPLES and frame.time_s > 1015.0:
            frame = frame._replace(signals={**frame.signals, **change})  # noqa: PLW2901
        out.append(frame)
    return out


def test_stuck_sensor() -> None:
    target = monitor()
    out = feed(target, altered({f"Sample{i}": 321.0 for i in range(4)}))
    assert set(qualities(out)[16:]) == {Q.NOT_AVAILABLE}
    assert FaultCode.SENSOR_STUCK in target.faults.active
    assert target.totals.total_kg < 10.0 * 12


def test_a_sensor_is_stuck_after_five_whole_seconds_without_change() -> None:
    target = monitor()
    feed(target, altered({f"Sample{i}": 321.0 for i in range(4)}))
    begun = next(e.time_s for e in target.fault_events if e.code is FaultCode.SENSOR_STUCK)
    assert begun == pytest.approx(1020.1, abs=0.05), "windows end a tenth after the full second"
    assert {math.isfinite(r.force_n) for r in target.records if 1015.2 < r.time_s < begun - 0.05} == {True}
    after = [r for r in target.records if r.time_s > begun - 0.05]
    assert {(r.quality, r.mass_kg, math.isfinite(r.force_n)) for r in after} == {(Q.NOT_AVAILABLE, 0.0, False)}


def test_a_sensor_at_a_standstill_is_not_stuck() -> None:
    quiet = Bench(flow=harvest(1005.0, 1015.0), rpm=lambda t: 400.0 if t < 1018 else 0.0).frames(30)
    level = {f"Sample{i}": 150.0 for i in range(4)}
    given = [
        f._replace(signals={**f.signals, **level}) if f.message == bus.IMPACT_SENSOR_SAMPLES and f.time_s > 1019.5 else f
        for f in quiet
    ]
    target = monitor()
    feed(target, given)
    assert not [e for e in target.fault_events if e.code is FaultCode.SENSOR_STUCK]


def test_saturated_sensor() -> None:
    target = monitor(estimator=ForceProportional())
    out = feed(target, altered({"Sample2": 4000.0}))
    assert set(qualities(out)[16:]) == {Q.SATURATED}
    assert FaultCode.SENSOR_SATURATED in target.faults.active


def test_sensor_that_reports_a_fault() -> None:
    target = monitor()
    out = feed(target, altered({"SensorStatus": 2}))
    assert set(qualities(out)[17:]) == {Q.NOT_AVAILABLE}
    assert FaultCode.SENSOR_MISSING in target.faults.active


def test_samples_that_are_not_available() -> None:
    target = monitor()
    out = feed(target, altered({f"Sample{i}": NOT_AVAILABLE for i in range(4)}))
    assert set(qualities(out)[17:]) == {Q.NOT_AVAILABLE}
    assert FaultCode.SENSOR_MISSING in target.faults.active


def test_more_than_a_full_paddle_is_saturated_and_counts_as_a_full_one() -> None:
    bench = Bench(flow=lambda t: 0.0 if t < 1005 else 10.0 if t < 1012 else 40.0)
    target = monitor()
    out = feed(target, bench.run(20))
    assert set(qualities(out)[13:]) == {Q.SATURATED}
    assert flows(out)[-1] == pytest.approx(30.0, rel=1e-3)
    assert FaultCode.FLOW_OUTSIDE_CALIBRATION in target.faults.active


def test_standing_header_and_ground_speed_close_the_gate_on_what_is_left() -> None:
    bench = Bench(flow=harvest(1005.0, 1e9, rate=0.8))
    header = [Frame(1000.0 + 0.5 * i, bus.HARVEST_STATE, {"HeaderDown": int(8 <= i < 30), "WorkState": 1}) for i in range(120)]
    frames = sorted([*bench.frames(60), *header], key=lambda f: f.time_s)
    out = feed(monitor(), run_of(frames))
    # Header up at 1015 s: grain still counts while the elevator empties, and no longer after 20 s.
    assert qualities(out)[25] is Q.OK
    assert set(qualities(out)[37:]) == {Q.NOT_HARVESTING}


def test_end_of_harvest_is_a_state_and_not_a_flow_of_zero() -> None:
    bench = replace(STEADY, flow=harvest(1005.0, 1015.0))
    out = feed(monitor(), bench.run(30))
    assert set(qualities(out)[20:]) == {Q.NOT_HARVESTING}
    assert set(states(out)[20:]) == {OperatingState.NOT_HARVESTING}
    assert all(f.signals["MassFlowRate"] is NOT_AVAILABLE for f in only(out, bus.MASS_FLOW)[20:])


def test_loads() -> None:
    target = monitor()
    feed(target, [f for f in STEADY_FRAMES if f.time_s < 1015.5])
    first = target.totals.load_kg
    target.start_load()
    assert target.totals.load_number == 2
    feed(target, [f for f in STEADY_FRAMES if 1015.5 <= f.time_s < 1020.5])
    target.stop_load()
    second = target.totals.load_kg
    feed(target, [f for f in STEADY_FRAMES if f.time_s >= 1020.5])
    assert target.totals.load_kg == second
    assert [load.number for load in target.loads] == [1, 2]
    assert target.loads[0].measured_kg == first
    assert target.totals.total_kg > first + second
    reference = target.ticket(2, 1234.0, 5.0)
    assert (reference.measured_kg, reference.reference_kg, reference.complete) == (second, 1234.0, True)
    assert target.reference_masses == (reference,)


@pytest.mark.parametrize(("load", "mass", "std"), [(9, 100.0, 1.0), (1, -1.0, 1.0), (1, float("nan"), 1.0), (1, 5.0, 0.0)])
def test_bad_tickets_are_refused(load: int, mass: float, std: float) -> None:
    with pytest.raises(ValueError, match=f"ticket for load {load}"):
        monitor().ticket(load, mass, std)


def test_dry_mass_follows_moisture() -> None:
    moist = [Frame(1000.5 + i, bus.GRAIN_CONDITION, {"Moisture": 20.0, "TestWeight": 720.0}) for i in range(30)]
    target = monitor()
    feed(target, sorted([*STEADY_FRAMES, *moist], key=lambda f: f.time_s))
    totals = target.totals
    assert totals.total_dry_kg == pytest.approx(totals.total_kg * (100 - 20) / (100 - 15.5), rel=1e-9)
    assert totals.total_unknown_moisture_kg == 0.0
    assert target.records[-1].test_weight_kg_m3 == 720.0


def test_tank_scale_gives_reference_masses() -> None:
    def tank(time_s: float) -> float:
        return 1000.0 + 10.0 * max(0.0, time_s - 1005.0)

    readings = [
        Frame(t, bus.TANK_SCALE, {"TankMass": tank(t), "TankScaleStatus": 0 if t < 1006 or t > 1060 else 1})
        for t in np.arange(1004.03, 1070.0).tolist()
    ]
    target = monitor(replace(EngineSettings(), reference_masses=ReferenceMassSettings(min_increment_kg=300.0)))
    feed(target, run_of(sorted([*replace(STEADY, scatter=0.0).frames(70), *readings], key=lambda f: f.time_s)))
    (reference,) = target.reference_masses
    assert reference.measured_kg == pytest.approx(reference.reference_kg, rel=0.01)
    assert reference.complete


def test_a_tank_scale_that_stands_still_between_passes_only_gives_reference_masses() -> None:
    def flow(time_s: float) -> float:
        return 10.0 if 1025.0 <= time_s < 1065.0 or 1085.0 <= time_s < 1125.0 else 0.0

    def tank(time_s: float) -> Frame:
        held_kg = 10.0 * (min(max(time_s - 1025.0, 0.0), 40.0) + min(max(time_s - 1085.0, 0.0), 40.0))
        return Frame(time_s, bus.TANK_SCALE, {"TankMass": held_kg, "TankScaleStatus": 1 if flow(time_s) else 0})

    target = monitor(replace(EngineSettings(), reference_masses=ReferenceMassSettings(min_increment_kg=700.0)))
    frames = replace(STEADY, flow=flow, scatter=0.0).frames(150)
    feed(target, run_of(sorted([*frames, *(tank(1000.5 + i) for i in range(149))], key=lambda f: f.time_s)))
    (reference,) = target.reference_masses
    assert reference.complete
    assert reference.measured_kg == pytest.approx(reference.reference_kg, abs=12.0)
    assert FaultCode.NOT_IDENTIFIABLE not in target.faults.active


class Scales:
    """A calibrator that keeps what it is given to weigh by."""

    def __init__(self) -> None:
        self.weighed: list[tuple[ReferenceMass, ...]] = []

    def update(self, records, estimator, *, use_sweep=True):  # type: ignore[no-untyped-def]
        raise AssertionError("no sweep here")

    def weigh(self, record, references, estimator, model_error):  # type: ignore[no-untyped-def]
        self.weighed.append(tuple(references))
        known = replace(estimator.parameters, version=estimator.parameters.version + 1)
        return CalibrationOutcome(ForceProportional(parameters=known), "weighed", weighed=True)

    def drift_std_dev(self, record, estimator):  # type: ignore[no-untyped-def]
        return 0.0

    def follow(self, record, estimator):  # type: ignore[no-untyped-def]
        return None

    def snapshot(self, now_s, total_kg):  # type: ignore[no-untyped-def]
        return None

    def restore(self, state, parameters, total_kg):  # type: ignore[no-untyped-def]
        raise AssertionError("nothing was kept")


def test_a_ticket_updates_when_the_window_under_way_ends() -> None:
    scales = Scales()
    target = monitor(calibrator=scales)
    frames = replace(STEADY, scatter=0.0).frames(30)
    feed(target, [f for f in frames if f.time_s < 1020.0])
    before = target.estimator.parameters.version
    reference = target.ticket(1, 250.0, 2.0)
    assert not scales.weighed
    feed(target, [f for f in frames if f.time_s >= 1020.0])
    assert scales.weighed == [(reference,)]
    assert target.estimator.parameters.version == before + 1
    assert target.outcome is not None
    assert target.outcome.reason == "weighed"


def test_snapshot_goes_on_where_it_ended() -> None:
    target = monitor()
    feed(target, STEADY_FRAMES)
    kept = EngineState.from_dict(target.snapshot().as_dict())
    assert kept == target.snapshot()
    again = monitor()
    again.restore(kept)
    later = [f._replace(time_s=f.time_s + 29.0) for f in STEADY_FRAMES if f.time_s > 1020.0]
    out = feed(again, later)
    assert set(qualities(out)[1:]) == {Q.OK}
    totals = [f.signals["TotalMass"] for f in only(out, bus.ACCUMULATED_MASS)]
    assert totals[0] >= kept.totals.total_kg
    assert totals == sorted(totals)
    assert only(out, bus.MASS_FLOW)[0].signals["WindowCounter"] == 30


VALUES = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.integers(-(10**400), 10**400),
    st.integers(0, 300),
    st.floats(0.0, 4000.0),
    st.sampled_from([bus.NOT_AVAILABLE, bus.ERROR]),
)
NAMES = sorted(
    {
        *(f"Sample{i}" for i in range(4)),
        *("SampleCounter", "SensorStatus", "ElevatorSpeed", "PlateAngle", "ActuatorState", "Moisture", "TestWeight"),
        *("TankMass", "TankScaleStatus", "HeaderDown", "WorkState", "Latitude", "Longitude"),
        *("CompassBearing", "NavigationSpeed"),
    }
)
TIMES = st.one_of(
    st.floats(0.0, 20.0), st.floats(-1e13, 1e13), st.sampled_from([math.nan, math.inf, -math.inf, 1e300, 0.0, 1.0, 1e9])
)
FRAMES = st.builds(
    Frame,
    time_s=TIMES,
    message=st.sampled_from([*bus.INPUTS, *bus.OUTPUTS, "NoSuchMessage"]),
    signals=st.dictionaries(st.sampled_from(NAMES), VALUES, max_size=10),
)


def check_output(out: list[Frame]) -> None:
    for frame in out:
        assert math.isfinite(frame.time_s)
        for value in frame.signals.values():
            assert value in (bus.NOT_AVAILABLE, bus.ERROR) or math.isfinite(value)  # type: ignore[arg-type]
        if frame.message == bus.PLATE_ACTUATOR_COMMAND and frame.signals["CommandMode"] != 0:
            assert 40.0 - 1e-9 <= frame.signals["TargetPlateAngle"] <= 90.0 + 1e-9  # type: ignore[operator]


@settings(max_examples=100)
@given(st.lists(FRAMES, max_size=60))
def test_no_sequence_of_frames_raises(frames: list[Frame]) -> None:
    check_output(feed(monitor(), frames))


@settings(max_examples=40)
@given(st.lists(st.tuples(st.integers(0, len(STEADY_FRAMES) - 1), FRAMES), max_size=40), st.integers(0, 2**31))
def test_junk_among_good_frames_never_raises_nor_runs_totals_back(junk: list[tuple[int, Frame]], seed: int) -> None:
    frames = list(STEADY_FRAMES[: 280 * 12])
    for place, frame in junk:
        frames.insert(place % len(frames), frame)
    target = monitor()
    out = feed(target, frames)
    check_output(out)
    masses = [f.signals["TotalMass"] for f in only(out, bus.ACCUMULATED_MASS)]
    assert masses == sorted(masses)  # type: ignore[type-var]


def test_estimator_that_knows_nothing_is_not_available() -> None:
    class Blank(ForceProportional):
        def estimate(self, *args: Any, **kwargs: Any) -> FlowEstimate:
            return super().estimate(float("nan"), 1.0, 1.0)

    out = feed(monitor(estimator=Blank()), STEADY_FRAMES[: 280 * 10])
    assert set(qualities(out)[6:]) == {Q.NOT_AVAILABLE}


def test_settings_of_the_machine_in_use() -> None:
    target = Monitor(EngineSettings(), MACHINE, ForceProportional())
    assert target.machine.sensor.gain_n_per_mv == 0.4448


def test_a_sensor_that_starts_and_stops_has_lost_nothing() -> None:
    target = monitor()
    frames = replace(STEADY, scatter=0.0).frames(20)
    quiet = [f for f in frames if f.message == bus.ELEVATOR_SPEED or 1004.5 < f.time_s < 1015.4]
    feed(target, quiet)
    assert FaultCode.SENSOR_MISSING in target.faults.active
    assert target.faults.occurrences(FaultCode.FRAMES_LOST) == 0


@pytest.mark.parametrize(
    ("lost", "complete"),
    [
        (lambda i: False, True),
        (lambda i: 2750 <= i < 2760, True),  # a sixth of a second: the window counts whole
        (lambda i: 2780 <= i < 3020, False),  # nearly all of one window
        (lambda i: 2750 <= i < 3500, False),  # whole windows
    ],
    ids=["nothing", "a little", "most of a window", "windows"],
)
def test_a_load_is_complete_when_no_window_of_it_is_missing(lost: Callable[[int], bool], complete: bool) -> None:
    target = monitor()
    frames = replace(STEADY, drop=lost).frames(20)
    feed(target, [f for f in frames if f.time_s < 1004.5])
    target.start_load()
    assert target.totals.load_number == 2
    feed(target, [f for f in frames if f.time_s >= 1004.5])
    assert target.totals.load_kg > 0.0
    assert target.ticket(2, 100.0, 1.0).complete is complete


@pytest.mark.parametrize(("zero_windows", "complete"), [(3, True), (7, False)])
def test_a_load_that_began_before_there_was_a_zero_is_complete_where_that_came_soon(zero_windows: int, complete: bool) -> None:
    """The elevator runs empty from the first second. Seven windows are more than there are before grain comes."""
    settings = EngineSettings()
    target = monitor(replace(settings, zero=replace(settings.zero, first_zero_windows=zero_windows)))
    feed(target, STEADY_FRAMES)
    assert (target.totals.load_kg > 0.0) is complete
    assert target.ticket(1, 100.0, 1.0).complete is complete


@pytest.mark.parametrize(("load_kg", "load_open", "complete"), [(50.0, True, False), (0.0, True, True)])
def test_a_load_with_grain_from_before_a_restart_is_not_complete(load_kg: float, load_open: bool, complete: bool) -> None:
    first = monitor()
    feed(first, STEADY_FRAMES)
    before, target = first.snapshot(), monitor()
    target.restore(replace(before, totals=replace(before.totals, load_kg=load_kg, load_open=load_open)))
    feed(target, STEADY_FRAMES)
    assert target.loads[-1].complete is complete


def test_away_from_home_the_standard_deviation_is_widened() -> None:
    found = {}
    for factor in (1.0, 3.0):
        # Where no sweep is to show it, the model has no error of its own away from home.
        sweep = replace(EngineSettings().sweep, max_std_dev_factor=factor, enabled=False)
        target = monitor(replace(NOISE_ALONE, sweep=sweep))
        feed(target, replace(STEADY, angle=lambda t: 70.0 if t < 1008.0 else 60.0).frames(15))
        record = target.records[-1]
        assert record.quality is Q.SWEEPING
        found[factor] = record.std_dev_kg_s
    assert found[3.0] == pytest.approx(3.0 * found[1.0])


def test_a_moving_plate_widens_by_the_delay_of_its_feedback_and_one_at_rest_does_not() -> None:
    target = monitor(NOISE_ALONE, estimator=ForceProportional(relative_std_dev=0.0))
    # 10 deg/s from 1010 s to 1012 s; the flow changes by 1.1 % a degree there.
    feed(target, replace(STEADY, angle=lambda t: 70.0 + min(max(10.0 * (t - 1010.0), 0.0), 20.0)).frames(20))
    widened = {round(r.time_s - 1000.0): r.noise_std_dev_kg_s / r.mass_flow_kg_s for r in target.records if r.mass_kg > 0.0}
    at_home, moving, at_rest = widened[9], widened[12], widened[16]
    assert at_rest == pytest.approx(at_home, rel=0.2)
    assert moving == pytest.approx(np.hypot(at_home, 0.07 * 10.0 * 0.009), rel=0.2)


def test_noise_that_is_widened_away_from_home_still_averages_out() -> None:
    widened = replace(NOISE_ALONE, sweep=replace(EngineSettings().sweep, max_std_dev_factor=3.0, enabled=False))
    target = monitor(widened, estimator=ForceProportional(relative_std_dev=0.0))
    frames = list(replace(STEADY, angle=lambda t: 70.0 if t < 1008.0 else 60.0).frames(40))
    feed(target, [frame for frame in frames if frame.time_s < 1011.0])
    # A load while the plate rests: its motion is a cause of its own.
    target.start_load()
    feed(target, [frame for frame in frames if frame.time_s >= 1011.0])
    away = [record for record in target.records if record.quality is Q.SWEEPING]
    load = target.open_load
    assert load is not None
    assert len(away) > 25
    assert load.budget.parameters_kg == pytest.approx(0.0, abs=1e-3)
    assert load.budget.motion_kg == 0.0
    seconds = [r for r in target.records if r.mass_kg > 0.0 and r.load_number == load.number]
    assert load.budget.noise_kg2 == pytest.approx(sum((r.noise_std_dev_kg_s * r.duration_s) ** 2 for r in seconds))
