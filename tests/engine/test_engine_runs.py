"""Runs of frames against the same frames one by one: equal to the last bit, whatever the bus brings and wherever a run is cut."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest
from engine_bench import (
    MACHINE,
    Actuator,
    Bench,
    ForceProportional,
    Kept,
    NothingBetweenUpdates,
    feed,
    monitor,
    run_with_actuator,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from studies.waveform.frame_runs import run_of
from yieldmon import frames as bus
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import Result, events_in, frames_in
from yieldmon.engine.sampling.windows import WindowBuilder
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.settings import EngineSettings, SweepSettings, WindowSettings
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError
from yieldmon.frames import ERROR, NOT_AVAILABLE, Frame, SweepState
from yieldmon.physics.machine import RPM

SETTINGS = EngineSettings(sweep=SweepSettings(first_after_s=18.0, angles_deg=(40.0, 55.0, 85.0, 90.0)))
BENCH = Bench(flow=lambda t: 10.0 if t > 1004 else 0.0, scatter=0.05)
SWEEP_S = 60.0


class SweepCalibrator(NothingBetweenUpdates):
    """A calibrator that gives an estimator of other uncertainty with each sweep."""

    def __init__(self) -> None:
        self.updates = 0

    def update(
        self,
        records: Sequence[WindowRecord],
        estimator: FlowEstimator,
        *,
        use_sweep: bool = True,
    ) -> CalibrationOutcome:
        self.updates += 1
        return CalibrationOutcome(ForceProportional(relative_std_dev=0.03 * (self.updates + 1)), "learnt")

    def weigh(
        self,
        record: WindowRecord,
        references: Sequence[ReferenceMass],
        estimator: FlowEstimator,
        model_error: AngleError = NO_ERROR,
    ) -> CalibrationOutcome:
        return self.update([record], estimator)


@dataclass
class Recorded:
    """A monitor that keeps what it is fed."""

    target: Kept
    frames: list[Frame] = field(default_factory=list)

    def feed(self, frame: Frame) -> list[Result]:
        self.frames.append(frame)
        return self.target.feed(frame)


def cut(frames: list[Frame], seed: int) -> Iterator[list[Frame]]:
    """Pieces from one frame to minutes long."""
    generator = np.random.default_rng(seed)
    first = 0
    while first < len(frames):
        last = first + int(np.exp(generator.uniform(0.0, np.log(12000))))
        yield frames[first:last]
        first = last


def assert_same(one_by_one: Kept, in_runs: Kept, pieces: Iterator[list[Frame]]) -> None:
    for piece in pieces:
        in_runs.feed_run(run_of(piece))
    assert repr(in_runs.results) == repr(one_by_one.results)
    assert repr(in_runs.snapshot()) == repr(one_by_one.snapshot())
    assert in_runs.reference_masses == one_by_one.reference_masses


ACTUATORS = [
    (Actuator(), SweepState.UPDATED),
    (Actuator(fault="stuck", fault_from_s=1025.0), SweepState.ABORTED),
    (Actuator(fault="silent", fault_from_s=1022.0, fault_to_s=1026.3), SweepState.ABORTED),
    (Actuator(fault="lying", fault_from_s=1010.0), SweepState.ABORTED),
    (Actuator(fault="manual", fault_from_s=1024.0, fault_to_s=1030.0), SweepState.ABORTED),
    (Actuator(fault="broken", fault_from_s=1024.0, fault_to_s=1030.0), SweepState.ABORTED),
    (Actuator(fault="silent", fault_from_s=1006.0, fault_to_s=1012.0), SweepState.UPDATED),
]


@pytest.mark.parametrize(("actuator", "state"), ACTUATORS, ids=[a.fault + str(int(a.fault_from_s)) for a, _ in ACTUATORS])
def test_a_sweep_and_what_can_befall_it(actuator: Actuator, state: SweepState) -> None:
    one_by_one = Recorded(monitor(SETTINGS, calibrator=SweepCalibrator()))
    expected = run_with_actuator(one_by_one, BENCH, actuator, SWEEP_S)  # type: ignore[arg-type]
    seen = {frame.signals["SweepState"] for frame in expected if frame.message == bus.SELF_CALIBRATION_STATUS}
    assert int(state) in seen
    whole = monitor(SETTINGS, calibrator=SweepCalibrator())
    assert_same(one_by_one.target, whole, iter([one_by_one.frames]))
    assert_same(one_by_one.target, monitor(SETTINGS, calibrator=SweepCalibrator()), cut(one_by_one.frames, 5))


def everything(seed: int, seconds: float) -> list[Frame]:
    """All inputs, each with gaps, unusable values and codes that nobody defined."""
    dice = np.random.default_rng(seed)

    def value(*usual: float | int) -> bus.Value:
        odd = (NOT_AVAILABLE, ERROR, -1.0, 1e9)
        return odd[dice.integers(len(odd))] if dice.random() < 0.15 else usual[dice.integers(len(usual))]

    frames = Bench(flow=lambda t: 10.0 if t % 30 > 8 else 0.0, seed=seed).frames(seconds)
    frames = [frame for frame in frames if dice.random() > 0.02]
    mass = 0.0
    for second in range(round(seconds)):
        mass += 12.0
        at = 1000.3137 + second
        if 20 < second < 33:
            continue
        frames += [
            Frame(at, bus.GRAIN_CONDITION, {"Moisture": value(14.5, 15.0), "TestWeight": value(700.0, 710.0)}),
            Frame(at + 0.01, bus.TANK_SCALE, {"TankMass": value(mass), "TankScaleStatus": value(0, 0, 0, 1, 2)}),
            Frame(at + 0.02, bus.HARVEST_STATE, {"HeaderDown": value(1, 1, 0), "WorkState": value(0, 1, 1)}),
            Frame(at + 0.03, bus.VEHICLE_POSITION, {"Latitude": value(49.5), "Longitude": value(11.0 + 1e-5 * second)}),
            Frame(at + 0.04, bus.VEHICLE_DIRECTION_SPEED, {"CompassBearing": value(90.0), "NavigationSpeed": value(0.1, 6.0)}),
            Frame(at + 0.05, bus.PLATE_ACTUATOR_FEEDBACK, {"PlateAngle": value(70.0), "ActuatorState": value(0, 1, 2, 3, 7)}),
            Frame(at + 0.06, bus.ELEVATOR_SPEED, {"ElevatorSpeed": value(400.0, 405.5)}),
        ]
    return sorted(frames, key=lambda frame: frame.time_s)


@pytest.mark.parametrize("seed", range(4))
def test_every_input_with_everything_that_may_be_wrong_with_it(seed: int) -> None:
    frames = everything(seed, 90.0)
    one_by_one = monitor()
    feed(one_by_one, frames)
    assert_same(one_by_one, monitor(), cut(frames, seed))


def test_the_benchs_run_is_that_of_its_frames() -> None:
    bench = replace(BENCH, drop=lambda i: i % 97 == 5, rpm=lambda t: 380.0 + t % 7.0)
    whole, expected = asdict(bench.run(12)), asdict(run_of(bench.frames(12)))
    np.testing.assert_equal(whole, expected)


def test_a_run_without_reports_leaves_out_just_those() -> None:
    frames = BENCH.frames(20)
    quiet, loud = monitor(), monitor()
    assert frames_in(quiet.feed_run(run_of(frames), reports=False)) == []
    assert frames_in(loud.feed_run(run_of(frames))) != []
    assert repr(quiet.records) == repr(loud.records)
    assert repr(events_in(quiet.results)) == repr(events_in(loud.results))


def test_an_empty_run_is_nothing() -> None:
    target = monitor()
    assert target.feed_run(run_of([])) == []
    assert feed(target, BENCH.frames(3)) == feed(monitor(), BENCH.frames(3))


@settings(max_examples=60)
@given(data=st.data())
def test_windows_closed_together_are_those_closed_one_by_one(data: st.DataObject) -> None:
    count = data.draw(st.integers(2, 9))
    dice = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    frames = 250 * count
    times = 0.004 * np.arange(1, frames + 1) - 0.0005
    samples = dice.uniform(-50.0, 4200.0, (frames, 4)) if data.draw(st.booleans()) else np.full((frames, 4), 300.0)
    samples[dice.random((frames, 4)) < data.draw(st.sampled_from([0.0, 0.1, 0.9]))] = np.nan
    statuses = dice.choice([0.0, 1.0, 2.0], frames, p=[0.9, 0.05, 0.05])
    table = np.column_stack((times, np.arange(frames) % 256, statuses, samples))
    silent = data.draw(st.sets(st.integers(0, count - 1)))
    gone = np.isin(times.astype(int), list(silent)) | (dice.random(frames) < data.draw(st.sampled_from([0.0, 0.3])))
    table = np.repeat(table[~gone], dice.choice([1, 1, 1, 1, 2], int((~gone).sum())), axis=0)

    def signal(most: int, low: float, high: float) -> list[tuple[float, float]]:
        at = np.sort(dice.uniform(0.0, count, dice.integers(0, most * count)))
        return list(zip(at.tolist(), dice.uniform(low, high, at.size).tolist(), strict=True))

    speeds, angles = signal(12, 0.0, 650.0 * RPM), signal(20, 0.7, 1.6)

    def part(points: list[tuple[float, float]], first: int, last: int) -> list[tuple[float, float]]:
        return [point for point in points if first <= point[0] < last]

    def closed(edges: list[int]) -> list[object]:
        builder, windows = WindowBuilder(WindowSettings(), MACHINE), []
        for first, last in pairwise(edges):
            builder.samples.add_block(table[(table[:, 0] >= first) & (table[:, 0] < last)])
            for time_s, value in part(speeds, first, last):
                builder.speed.add(time_s, value)
            inside = part(angles, first, last)
            builder.angle.extend([t for t, _ in inside], [v for _, v in inside])
            windows += builder.close_run([float(second) for second in range(first, last + 1)])
        return windows

    middle = data.draw(st.integers(1, count - 1))
    expected = repr(closed(list(range(count + 1))))
    assert repr(closed([0, count])) == expected
    assert repr(closed([0, middle, count])) == expected
