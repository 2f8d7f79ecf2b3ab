"""A weighed mass that contradicts the calibration: when it is said, what is said, and when it ends."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from math import nan

import numpy as np
import pytest
from engine_bench import MACHINE, PARAMETERS, Bench, ForceProportional, feed, monitor
from scipy.stats import norm

from studies.waveform.frame_runs import run_of
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import frames_in
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.engine.self_calibration.scale_alarm import ScaleAlarm, ScaleCheck, as_stated
from yieldmon.engine.settings import FaultSettings
from yieldmon.engine.state import EngineState
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.effects import ChainSlip, Effects
from yieldmon.plant.profiles import FlowProfile, Steady
from yieldmon.plant.scenario import Scenario
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration

CODE = FaultCode.SCALE_DISAGREES
STEADY = Bench(flow=lambda t: 10.0 if t >= 1008.0 else 0.0, noise_mv=1.0)


def check(z: float, name: str = "load 2", weighed_kg: float = 5000.0, std_dev_kg: float = 100.0) -> ScaleCheck:
    """A load measured z standard deviations too heavy."""
    return ScaleCheck(name, 1.7e9, weighed_kg, weighed_kg + z * std_dev_kg, std_dev_kg)


@pytest.mark.parametrize("z", [-5.0, -1.0, 0.0, 0.5, 3.3])
def test_probability_is_that_of_the_normal_distribution(z: float) -> None:
    assert check(z).p_value == pytest.approx(2.0 * norm.sf(abs(z)), rel=1e-9)


@pytest.mark.parametrize(
    ("zs", "present"),
    [
        ([], False), ([3.2], False), ([-3.2], False), ([3.4], True), ([-3.4], True),
        ([4.0, 2.5], True), ([4.0, 1.9], False), ([4.0, -1.0], False), ([4.0, 1.0, 4.0], True), ([0.0, 2.5], False),
    ],
)  # fmt: skip
def test_raised_below_one_in_a_thousand_and_ended_by_one_that_agrees(zs: list[float], present: bool) -> None:
    alarm = ScaleAlarm(FaultSettings())
    for z in zs:
        alarm.see([check(z)])
    assert (alarm.detail is not None) is present


def test_says_scale_by_how_much_since_when_and_what_to_check() -> None:
    alarm = ScaleAlarm(FaultSettings())
    alarm.see([check(0.3, "load 1"), check(6.0), check(7.0, "load 3")])
    said = alarm.detail
    assert said is not None
    assert said.startswith("scale: load 3 weighed 5000 kg, measured 5700 kg: +14.0 +- 2.0 % (p 3e-12), since load 2")
    assert "2023-11-14 22:13 UTC" in said
    assert "load 1 still agreed" in said
    for cause in ("ticket", "slip", "wear", "gain"):
        assert cause in said


@pytest.mark.parametrize(
    ("zs", "named"),
    [
        ([6.0], False),
        ([6.0, 7.0], True),
        ([-6.0, -6.0], True),
        ([6.0, -6.0], False),
        ([6.0, 7.0, -6.0], False),
        ([6.0, 0.3, 6.0], False),
    ],
)
def test_two_in_a_row_that_are_off_the_same_way_name_the_remedy_for_a_changed_machine(zs: list[float], named: bool) -> None:
    alarm = ScaleAlarm(FaultSettings())
    alarm.see([check(z, f"load {number}") for number, z in enumerate(zs, 1)])
    assert ("yieldmon calibrations restart" in (alarm.detail or "")) is named


def test_a_calibration_from_outside_ends_it() -> None:
    alarm = ScaleAlarm(FaultSettings())
    alarm.see([check(6.0)])
    alarm.accept()
    assert alarm.detail is None


@pytest.mark.parametrize("zs", [[], [1.0], [6.0], [1.0, 6.0]])
def test_outlives_a_restart(zs: list[float]) -> None:
    alarm, after = ScaleAlarm(FaultSettings()), ScaleAlarm(FaultSettings())
    for z in zs:
        alarm.see([check(z)])
    document = json.loads(json.dumps(EngineState(scale_alarm=alarm.state).as_dict()))
    after.restore(EngineState.from_dict(document).scale_alarm)
    assert after.state == alarm.state
    assert after.detail == alarm.detail


def test_a_state_from_before_there_was_one_has_none() -> None:
    document = EngineState().as_dict()
    del document["scale_alarm"]
    assert EngineState.from_dict(document) == EngineState()


def mass(measured_kg: float, *, complete: bool = True, budget: MassBudget | None = None) -> ReferenceMass:
    known = MassBudget(0.0, 200.0, 0.0, 0.0) if budget is None else budget
    return ReferenceMass(ReferenceSource.TICKET, 0.0, 500.0, 5000.0, 150.0, measured_kg, complete, 4, known)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (mass(5500.0), ScaleCheck("load 4", 0.0, 5000.0, 5500.0, 250.0)),
        (mass(5500.0, budget=MassBudget.unknown()), ScaleCheck("load 4", 0.0, 5000.0, 5500.0, 150.0)),
        (mass(0.0), None), (mass(nan), None), (mass(5500.0, complete=False), None),
    ],
)  # fmt: skip
def test_without_learning_the_stated_deviation_decides(given: ReferenceMass, expected: ScaleCheck | None) -> None:
    assert as_stated(given) == expected


def weighed(target: Monitor, factor: float, seconds: float = 60.0) -> str:
    """The fault's word after a ticket of `factor` times what was measured; "" where the fault is not shown."""
    frames = STEADY.frames(seconds)
    cut = len(frames) - 2000
    third = len(frames) // 3
    feed(target, run_of(frames[:third]))
    target.start_load()
    feed(target, run_of(frames[third:cut]))
    load = target.open_load
    assert load is not None
    target.start_load()
    target.ticket(load.number, factor * load.measured_kg, 1.0)
    feed(target, run_of(frames[cut:]))
    return target.faults.detail(CODE) if CODE in target.records[-1].faults else ""  # type: ignore[attr-defined]


@pytest.mark.parametrize(("factor", "shown"), [(1.0, False), (0.95, False), (1.15, True), (0.85, True)])
def test_a_monitor_that_may_not_learn_still_reports(factor: float, shown: bool) -> None:
    said = weighed(monitor(estimator=ForceProportional(relative_std_dev=0.02)), factor)
    assert bool(said) is shown


CERTAIN = ParameterSet(
    PARAMETERS.values,
    ("friction", "restitution", "density"),
    np.diag([0.002**2, 0.005**2, 10.0**2]),
)


@pytest.mark.parametrize(("spread", "shown"), [(1.0, True), (1000.0, False)])
def test_the_calibrators_own_deviation_decides(spread: float, shown: bool) -> None:
    """10 % off is a contradiction for parameters that claim 1 % and none for those that claim next to nothing."""
    known = replace(CERTAIN, covariance=spread * np.array(CERTAIN.covariance))
    model = ForwardModel(MACHINE)
    calibrator = ClosedLoopCalibrator(model)
    before = OpenLoop(model, known)
    reference = replace(mass(5500.0), std_dev_kg=5.0)
    record = monitor_record()
    outcome = calibrator.weigh(record, (reference,), before)
    assert [c.p_value < 0.001 for c in outcome.checks] == [shown]
    assert outcome.checks[0].error_pct == pytest.approx(10.0, abs=0.2)
    estimator = outcome.estimator or before
    assert calibrator.weigh(record, (reference,), estimator).checks == ()


def monitor_record():  # type: ignore[no-untyped-def]
    target = monitor()
    feed(target, STEADY.run(15))
    return target.records[-1]  # type: ignore[attr-defined]


def slipping(share: float) -> tuple[list[str], list[str]]:
    """Faults' details by ticket, first and second load, of a virtual combine whose chain slips, with the shipped settings."""
    pieces = [(8.0, 0.0), (20.0, 12.0), (6.0, 0.0), (15.0, 12.0), (6.0, 0.0)]
    flow = FlowProfile(pieces=[Steady(kind="steady", duration_s=s, flow_kg_s=f) for s, f in pieces], variation_pct=1.5)
    effects = Effects(**{**Scenario().effects.model_dump(), "chain_slip": ChainSlip(share=share)} if share else {})
    settings = configuration.load(shipped("config/yieldmon.yaml"))
    combine = VirtualCombine(Scenario(duration_s=60.0, effects=effects, flow=flow), settings.machine, 7)
    target = build_monitor(settings.engine, settings.machine, settings.parameters, settings.calibrator)

    def until(time_s: float) -> None:
        for frame in combine.frames_until(time_s):
            for answer in frames_in(target.feed(frame)):
                combine.handle(answer)

    before_kg, said, shown = 0.0, [], []
    until(6.0)
    for number, end_s in ((2, 33.0), (3, 54.0)):
        target.start_load()
        until(end_s)
        true_kg = float(combine.delivered_kg(np.array([end_s]))[0])
        target.stop_load()
        target.ticket(number, true_kg - before_kg, 5.0)
        until(end_s + 3.0)
        before_kg = true_kg
        said.append(target.faults.detail(CODE))
        shown.append(target.faults.is_active(CODE))
    return said, shown


def test_chain_slip_raises_it_at_the_first_ticket_and_it_ends_when_the_scale_is_learnt() -> None:
    said, shown = slipping(0.06)
    assert shown == [True, False]
    found = re.match(r"scale: load 2 weighed \d+ kg, measured \d+ kg: (-[\d.]+) \+- ([\d.]+) %", said[0])
    assert found is not None
    assert -20.0 < float(found[1]) < -6.0
    assert float(found[2]) < 3.0


def test_nothing_is_raised_without_slip() -> None:
    assert slipping(0.0)[1] == [False, False]


@pytest.mark.parametrize(("right_kg", "present"), [(5060.0, False), (4950.0, False), (5270.0, True), (6900.0, True)], ids=str)
def test_the_right_mass_for_the_load_that_contradicts_is_held_against_what_was_measured_before(
    right_kg: float, present: bool
) -> None:
    """The wrong mass has updated the parameters: by now the load is measured with 30 % more."""
    alarm = ScaleAlarm(FaultSettings())
    alarm.see([ScaleCheck("load 2", 1.7e9, 6500.0, 5000.0, 100.0)])
    assert alarm.detail is not None
    alarm.see([ScaleCheck("load 2", 1.7e9, right_kg, 6500.0, 100.0)])
    assert (alarm.detail is not None) is present
    assert alarm.detail is None or alarm.detail.startswith(f"scale: load 2 weighed {right_kg:.0f} kg, measured 5000 kg: ")
    alarm.see([ScaleCheck("load 3", 1.7e9, 5000.0, 6500.0, 100.0)])
    assert alarm.detail is not None, "of another load, what the parameters in use make of it counts"
