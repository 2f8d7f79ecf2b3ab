"""Whole sweeps of the monitor with an actuator in the loop, and every way in which the actuator can fail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import sqrt

import pytest
from engine_bench import (
    HOME_DEG,
    Actuator,
    Bench,
    ForceProportional,
    NothingBetweenUpdates,
    monitor,
    only,
    qualities,
    run_with_actuator,
)

from yieldmon import frames as bus
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.settings import EngineSettings, SweepSettings
from yieldmon.engine.sweeps.sweep_inputs import SweepAbort
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError
from yieldmon.frames import EstimateQuality, Frame, SweepState
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.history.resumption import successor

SETTINGS = EngineSettings(sweep=SweepSettings(first_after_s=18.0, angles_deg=(40.0, 55.0, 85.0, 90.0)))
BENCH = Bench(flow=lambda t: 10.0 if t > 1004 else 0.0, scatter=0.05)
SWEEP_S = 55.0
"""Enough for one whole sweep of SETTINGS."""


@dataclass
class SweepCalibrator(NothingBetweenUpdates):
    """A calibrator that keeps what it was given and answers with a set outcome."""

    outcome: CalibrationOutcome
    given: list[Sequence[WindowRecord]] = field(default_factory=list)

    def update(
        self,
        records: Sequence[WindowRecord],
        estimator: FlowEstimator,
        *,
        use_sweep: bool = True,
    ) -> CalibrationOutcome:
        self.given.append(records)
        return self.outcome

    def weigh(
        self,
        record: WindowRecord,
        references: Sequence[ReferenceMass],
        estimator: FlowEstimator,
        model_error: AngleError = NO_ERROR,
    ) -> CalibrationOutcome:
        raise AssertionError("nothing was weighed")


def sweep_states(out: list[Frame]) -> list[SweepState]:
    """Distinct states in their order."""
    seen = [SweepState(f.signals["SweepState"]) for f in only(out, bus.SELF_CALIBRATION_STATUS)]
    return [state for i, state in enumerate(seen) if i == 0 or state is not seen[i - 1]]


def test_a_whole_sweep_updates_and_measuring_goes_on() -> None:
    better = ForceProportional(parameters=replace(ForceProportional().parameters, version=7))
    calibrator = SweepCalibrator(CalibrationOutcome(better, "learnt"))
    target, actuator = monitor(SETTINGS, calibrator=calibrator), Actuator()
    out = run_with_actuator(target, BENCH, actuator, SWEEP_S)
    records = target.records

    (given,) = calibrator.given
    angles = {}
    for record in given:
        assert record.usable_for_calibration
        assert record.plate_still
        angles.setdefault(record.sweep_step, []).append(record.plate_angle_rad * 57.29577951308232)
    assert [len(values) for values in angles.values()] == [2] * 7
    expected = [70.0, 40.0, 55.0, 70.0, 85.0, 90.0, 70.0]
    assert [sum(values) / 2 for values in angles.values()] == pytest.approx(expected, abs=0.3)

    harvesting = records[6:]
    assert all(r.mass_flow_kg_s == pytest.approx(10.0, rel=0.12) for r in harvesting)
    assert {r.quality for r in harvesting} == {EstimateQuality.OK, EstimateQuality.SWEEPING}
    away = [r for r in harvesting if abs(r.plate_angle_rad - 1.2217) > 0.1]
    home = [r for r in harvesting if r.quality is EstimateQuality.OK]
    before = [r for r in home if r.time_s < away[0].time_s]
    # Of the first sweep nothing is known before it: the farther from a throw square to the plate, the less sure is the flow.
    by_angle = {
        angle: [r.std_dev_kg_s for r in away if abs(r.plate_angle_rad * 57.29578 - angle) < 0.5] for angle in (40.0, 55.0, 85.0)
    }
    assert min(min(found) for found in by_angle.values()) > max(r.std_dev_kg_s for r in before)
    assert min(by_angle[40.0]) > max(by_angle[55.0])
    assert sweep_states(out)[-1] is SweepState.UPDATED
    assert records[-1].parameter_version == 7
    assert actuator.angle_deg == pytest.approx(HOME_DEG, abs=0.1)
    assert actuator.modes[-1] == bus.CommandMode.RELEASE


@pytest.mark.parametrize("sweeps", [True, False], ids=["a sweep is to come", "none is"])
def test_a_second_is_as_unsure_as_its_load_before_the_first_sweep(sweeps: bool) -> None:
    settings = replace(SETTINGS, sweep=replace(SETTINGS.sweep, enabled=sweeps, first_after_s=600.0))
    target = monitor(settings, calibrator=SweepCalibrator(CalibrationOutcome(None, "nothing")))
    run_with_actuator(target, BENCH, Actuator(), 40.0)
    record = target.records[-1]
    shared = sqrt(record.std_dev_kg_s**2 - record.noise_std_dev_kg_s**2) / record.mass_flow_kg_s
    assert shared == pytest.approx(record.load_std_dev_kg / record.load_kg, rel=0.1)
    assert (shared > 0.05) == sweeps


def test_a_sweep_that_a_reload_ends_is_begun_anew() -> None:
    target = monitor(SETTINGS)
    loaded = configuration.load(shipped("config/yieldmon.yaml"), {})
    run_with_actuator(target, BENCH, Actuator(), 24.0)
    assert target.sweep.visiting
    assert successor(target, loaded, None, 1.7e9).sweep.schedule.requested


def test_commands_come_ten_times_a_second_with_a_counter_and_within_the_rate() -> None:
    out = run_with_actuator(monitor(SETTINGS), BENCH, Actuator(), SWEEP_S)
    commands = only(out, bus.PLATE_ACTUATOR_COMMAND)
    steps = [round(b.time_s - a.time_s, 6) for a, b in pairwise(commands)]
    assert set(steps) == {0.1}
    assert [c.signals["CommandCounter"] for c in commands] == [i % 256 for i in range(len(commands))]
    targets = [c.signals["TargetPlateAngle"] for c in commands[:-1]]
    moves = [abs(b - a) for a, b in pairwise(targets)]  # type: ignore[operator]
    assert max(moves) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("outcome", "state", "faults"),
    [
        (CalibrationOutcome(None, "nothing new"), SweepState.NOT_LEARNED, set()),
        (CalibrationOutcome(None, "as wide as before", identifiable=False), SweepState.NOT_LEARNED, {FaultCode.NOT_IDENTIFIABLE}),
    ],
)
def test_what_a_sweep_did_not_update(outcome: CalibrationOutcome, state: SweepState, faults: set[FaultCode]) -> None:
    target = monitor(SETTINGS, calibrator=SweepCalibrator(outcome))
    out = run_with_actuator(target, BENCH, Actuator(), SWEEP_S)
    assert sweep_states(out)[-1] is state
    assert set(target.faults.active) == faults


FAILURES = [
    # actuator, reason of the first abort, faults that it raises
    (Actuator(fault="stuck", fault_from_s=1030.0, fault_to_s=1040.0), SweepAbort.NOT_FOLLOWING, {FaultCode.PLATE_NOT_FOLLOWING}),
    (Actuator(rate_deg_s=2.0), SweepAbort.NOT_FOLLOWING, {FaultCode.PLATE_NOT_FOLLOWING}),
    (
        Actuator(fault="silent", fault_from_s=1030.0, fault_to_s=1034.0),
        SweepAbort.FEEDBACK_STALE,
        {FaultCode.PLATE_FEEDBACK_STALE},
    ),
    (Actuator(fault="broken", fault_from_s=1030.0, fault_to_s=1033.0), SweepAbort.ACTUATOR_FAULT, set()),
    (Actuator(fault="manual", fault_from_s=1030.0, fault_to_s=1040.0), SweepAbort.MANUAL, set()),
]


@pytest.mark.parametrize(("actuator", "reason", "faults"), FAILURES, ids=lambda value: getattr(value, "fault", ""))
def test_a_failing_actuator_ends_the_sweep_and_the_plate_goes_home(
    actuator: Actuator, reason: SweepAbort, faults: set[FaultCode]
) -> None:
    target = monitor(SETTINGS)
    out = run_with_actuator(target, BENCH, replace(actuator, modes=[], targets=[]), 62.0)
    events = target.fault_events
    aborted = next(event for event in events if event.code is FaultCode.SWEEP_ABORTED)
    assert aborted.detail == reason.value
    assert {event.code for event in events if event.active} >= faults
    angles = [r.plate_angle_rad * 57.29577951308232 for r in target.records]
    assert angles[-1] == pytest.approx(HOME_DEG, abs=0.6)
    assert set(qualities(out)[-3:]) == {EstimateQuality.OK}


def test_implausible_plate_feedback_is_found_by_the_force() -> None:
    calibrator = SweepCalibrator(CalibrationOutcome(ForceProportional(), "must not be asked"))
    target = monitor(SETTINGS, calibrator=calibrator)
    run_with_actuator(target, BENCH, Actuator(fault="lying"), SWEEP_S)
    assert target.sweep.abort_reason is SweepAbort.FORCE_DOES_NOT_FOLLOW
    assert {FaultCode.PLATE_NOT_FOLLOWING, FaultCode.SWEEP_ABORTED} <= set(target.faults.active)
    assert calibrator.given == []


FROZEN_AWAY_S = 1029.5
"""The plate rests at 40 degrees."""


@pytest.mark.parametrize("from_s", [1000.0, FROZEN_AWAY_S], ids=["at home", "at 40 degrees"])
def test_a_flow_is_right_within_its_deviation_once_the_feedback_of_a_moving_plate_is_known_to_stay(from_s: float) -> None:
    target, actuator = monitor(SETTINGS), Actuator(fault="frozen", fault_from_s=from_s)
    run_with_actuator(target, BENCH, actuator, 70.0)
    known_s = next(e.time_s for e in target.fault_events if e.code == FaultCode.PLATE_NOT_FOLLOWING)
    first_away_s = 1000.0 + SETTINGS.sweep.first_after_s + 4.0
    assert known_s < max(from_s, first_away_s) + 8.0
    after = [record for record in target.records if record.time_s > known_s + 8.0]
    assert max(abs(record.mass_flow_kg_s - 10.0) / record.std_dev_kg_s for record in after) < 2.5
    assert actuator.angle_deg == pytest.approx(HOME_DEG, abs=0.01)


@pytest.mark.parametrize(
    ("bench", "reason"),
    [
        (replace(BENCH, flow=lambda t: 0.0 if t < 1004 else 10.0 if t < 1030 else 19.0), SweepAbort.FLOW_CHANGED),
        (replace(BENCH, flow=lambda t: 10.0 if 1004 < t < 1030 else 0.0), SweepAbort.NOT_MEASURED),
        (replace(BENCH, rpm=lambda t: 400.0 if t < 1030 else 440.0), SweepAbort.SPEED_CHANGED),
        (replace(BENCH, drop=lambda i: 7500 < i < 8400), SweepAbort.FEEDBACK_STALE),
    ],
    ids=["flow changes", "harvest ends", "speed changes", "bus falls silent"],
)
def test_conditions_that_change_end_the_sweep(bench: Bench, reason: SweepAbort) -> None:
    target, actuator = monitor(SETTINGS), Actuator()
    run_with_actuator(target, bench, actuator, 55.0)
    assert target.sweep.abort_reason in (reason, SweepAbort.FLOW_CHANGED)
    assert actuator.angle_deg == pytest.approx(HOME_DEG, abs=0.6)


def test_the_operator_can_ask_for_a_sweep_and_end_it() -> None:
    settings = EngineSettings(sweep=replace(SETTINGS.sweep, enabled=False))
    target, actuator = monitor(settings), Actuator()
    orders = {16.0: Monitor.request_sweep, 30.0: Monitor.abort_sweep}
    out = run_with_actuator(target, BENCH, actuator, 45.0, at=orders)
    assert sweep_states(out)[-1] is SweepState.ABORTED
    assert target.sweep.abort_reason is SweepAbort.OPERATOR
    assert actuator.angle_deg == pytest.approx(HOME_DEG, abs=0.1)


def test_a_restart_in_mid_sweep_takes_the_plate_home() -> None:
    actuator = Actuator(angle_deg=45.0)
    target = monitor(SETTINGS)
    run_with_actuator(target, BENCH, actuator, 15.0)
    assert actuator.angle_deg == pytest.approx(HOME_DEG, abs=0.6)
    assert target.sweep.abort_reason is None
