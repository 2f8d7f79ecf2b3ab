"""The error budget of flow and mass: how parts add, what is unknown, and what the monitor publishes of it."""

from __future__ import annotations

import re
from dataclasses import replace
from math import hypot, isnan, nan, sqrt

import numpy as np
import pytest
from engine_bench import ZERO_MV, Bench, ForceProportional, feed, monitor
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.faults import FaultCode
from yieldmon.engine.mass.budget import EMPTY, FlowBudget, MassBudget, zero_std_dev_mv
from yieldmon.engine.mass.load_summary import LoadClosed
from yieldmon.engine.mass.loads import Loads
from yieldmon.engine.mass.moisture_reference import MoistureReference
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.settings import BudgetSettings, EngineSettings
from yieldmon.engine.state import EngineState

SETTINGS = BudgetSettings()
STEADY = Bench(flow=lambda t: 10.0 if t >= 1005.0 else 0.0, scatter=0.05, noise_mv=2.0, paddle_vibration_mv=3.0)
parts = st.floats(0.0, 50.0)


@given(noise=parts, parameters=parts, zero=parts, moisture=parts, seconds=st.integers(1, 200))
def test_noise_averages_out_and_the_rest_does_not(
    noise: float, parameters: float, zero: float, moisture: float, seconds: int
) -> None:
    flow = FlowBudget(noise, parameters, zero, moisture)
    budget = EMPTY
    for _ in range(seconds):
        budget = budget.plus(flow, 1.0)
    expected = hypot(noise * sqrt(seconds), parameters * seconds, zero * seconds, moisture * seconds)
    assert budget.std_dev_kg == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_an_error_of_a_moving_plate_is_gone_when_it_is_back() -> None:
    out, home = (FlowBudget(hypot(0.3, 0.4), 0.0, motion_kg_s=sign * 0.4) for sign in (1.0, -1.0))
    away = EMPTY.plus(out, 1.0).plus(out, 1.0)
    assert away.std_dev_kg == pytest.approx(hypot(0.3 * sqrt(2.0), 0.8))
    assert away.plus(home, 1.0).plus(home, 1.0).std_dev_kg == pytest.approx(0.6)


def test_a_new_load_begins_without_error() -> None:
    totals = Totals().with_mass(10.0, None, FlowBudget(1.0, 1.0), 1.0).start_load()
    assert totals.load_budget.std_dev_kg == 0.0
    assert totals.total_budget.std_dev_kg == pytest.approx(sqrt(2.0))


def test_mass_of_a_flow_without_a_budget_has_no_standard_deviation() -> None:
    assert isnan(Totals().with_mass(10.0, None).load_budget.std_dev_kg)


@pytest.mark.parametrize(
    ("since_empty_s", "expected_mv"), [(0.0, 0.2), (-5.0, 0.2), (3600.0, hypot(0.2, 1.0)), (4 * 3600.0, hypot(0.2, 2.0))]
)
def test_the_zero_is_less_certain_the_longer_it_was_not_measured(since_empty_s: float, expected_mv: float) -> None:
    assert zero_std_dev_mv(SETTINGS, since_empty_s) == pytest.approx(expected_mv)


@pytest.mark.parametrize(("away_mv", "expected_mv"), [(0.0, 0.2), (0.59, 0.2), (0.61, 0.61), (15.0, 15.0)])
def test_the_zero_is_as_uncertain_as_the_empty_plate_was_seen_away_from_it(away_mv: float, expected_mv: float) -> None:
    assert zero_std_dev_mv(SETTINGS, 0.0, away_mv) == pytest.approx(expected_mv)


@pytest.mark.parametrize(
    ("seen", "calibrated", "followed", "expected_pct"),
    [
        ([15.0], None, False, 0.0),
        ([15.0] * 6 + [18.0] * 60, None, False, 3.0),
        ([18.0] * 6 + [15.0] * 60, None, False, 3.0),
        ([15.0, 18.0], None, True, 0.0),
        ([18.0], (14.0, 16.0), False, 2.0),
        ([13.0], (14.0, 16.0), False, 1.0),
        ([15.0], (14.0, 16.0), False, 0.0),
        ([nan], None, False, 2.0),
        ([nan, 20.0], None, False, 0.0),
        ([15.0] * 6 + [18.0] * 60 + [nan], None, False, hypot(3.0, 2.0)),
    ],
)
def test_moisture_that_moves_without_a_map_widens(
    seen: list[float], calibrated: tuple[float, float] | None, followed: bool, expected_pct: float
) -> None:
    reference = MoistureReference(SETTINGS)
    found = [reference.relative_std_dev(value, 1, calibrated, followed=followed) for value in seen][-1]
    assert found == pytest.approx(SETTINGS.moisture_per_pct * expected_pct, rel=1e-3)


def _mean_square_pct2(moved_pct: float, scatter_pct: float) -> float:
    """Mean over sensors of the stated distance of grain that is so far from the first grain, squared, over a load of 200 s."""
    rng = np.random.default_rng(4)
    found = []
    for _ in range(200):
        reference = MoistureReference(SETTINGS)
        first, later = 15.0 + scatter_pct * rng.standard_normal(12), 15.0 + moved_pct + scatter_pct * rng.standard_normal(200)
        stated = [reference.relative_std_dev(value, 1, None, followed=False) for value in (*first.tolist(), *later.tolist())]
        found.append(float(np.mean(stated[-150:])) / SETTINGS.moisture_per_pct)
    return float(np.mean(np.square(found)))


def test_the_scatter_of_a_moisture_sensor_is_no_moisture_that_moves() -> None:
    """Readings 0.2 points about a steady moisture: 0.05 points are left, 0.1 % of a load."""
    assert _mean_square_pct2(0.0, 0.2) < 0.06**2


@pytest.mark.parametrize("moved_pct", [0.3, -1.0, 4.0])
def test_moisture_that_has_moved_counts_in_full_beside_a_sensor_that_scatters(moved_pct: float) -> None:
    assert _mean_square_pct2(moved_pct, 0.2) ** 0.5 == pytest.approx(abs(moved_pct), rel=0.1)


def _after(*readings: float) -> MoistureReference:
    reference = MoistureReference(SETTINGS)
    for value in readings:
        reference.relative_std_dev(value, 1, None, followed=False)
    return reference


def test_other_parameters_have_a_moisture_of_their_own() -> None:
    reference = _after(*[15.0] * 6, *[20.0] * 60)
    assert reference.relative_std_dev(20.0, 1, None, followed=False) == pytest.approx(5.0 * SETTINGS.moisture_per_pct, rel=1e-3)
    assert reference.relative_std_dev(20.0, 2, None, followed=False) == 0.0


@pytest.mark.parametrize(("grain_pct", "away_pct"), [(nan, 5.0), (18.0, 2.0), (20.0, 0.0)])
def test_parameters_that_hold_for_known_grain_keep_its_moisture(grain_pct: float, away_pct: float) -> None:
    """A sweep leaves the scale at the moisture it was set at; a ticket sets it at that of its load."""
    reference = _after(*[15.0] * 6, *[20.0] * 60)
    reference.hold(2, grain_pct)
    found = reference.relative_std_dev(20.0, 2, None, followed=False)
    assert found == pytest.approx(away_pct * SETTINGS.moisture_per_pct, rel=1e-3, abs=1e-5)


def test_the_moisture_of_the_parameters_outlives_a_restart() -> None:
    state = EngineState(moisture=_after(15.0, 16.0).state)
    assert EngineState.from_dict(state.as_dict()) == state
    document = state.as_dict()
    del document["moisture"]
    assert EngineState.from_dict(document).moisture is None


def test_records_and_frames_carry_the_standard_deviation_of_the_masses() -> None:
    target = monitor(estimator=ForceProportional(relative_std_dev=0.04))
    sent = feed(target, STEADY.run(60))
    record = target.records[-1]
    # 4 % is common to all seconds; the unmeasured moisture adds its 4 %.
    assert record.load_std_dev_kg / record.load_kg == pytest.approx(hypot(0.04, 0.04), rel=0.1)
    assert record.noise_std_dev_kg_s < record.std_dev_kg_s
    shown = [frame.signals for frame in sent if frame.message == "MassStdDev"][-1]
    assert shown == {"LoadMassStdDev": record.load_std_dev_kg, "TotalMassStdDev": record.total_std_dev_kg}


@pytest.mark.parametrize("budget", [EMPTY, MassBudget(4.0, 1.0, 0.5, 0.25), MassBudget.unknown()])
def test_a_budget_outlives_a_restart(budget: MassBudget) -> None:
    state = EngineState(totals=Totals(total_kg=20.0, load_kg=10.0, total_budget=budget, load_budget=budget))
    back = EngineState.from_dict(state.as_dict()).totals
    assert repr(back) == repr(state.totals)


def test_masses_of_a_store_without_budgets_have_an_unknown_one() -> None:
    document = EngineState(totals=Totals(total_kg=20.0)).as_dict()
    for name in ("total_budget", "load_budget"):
        del document["totals"][name]
    totals = EngineState.from_dict(document).totals
    assert isnan(totals.total_budget.std_dev_kg)
    assert totals.load_budget == EMPTY


QUICK = replace(EngineSettings(), faults=replace(EngineSettings().faults, zero_missing_s=10.0))
EMPTY_ELEVATOR = Bench(noise_mv=2.0)


def test_vibration_too_large_for_a_zero_is_a_fault_with_figures() -> None:
    target = monitor(QUICK)
    feed(target, replace(EMPTY_ELEVATOR, paddle_vibration_mv=20.0).run(25))
    shown = [FaultCode.ZERO_MISSING in record.faults for record in target.records]
    assert shown.index(True) in range(10, 14)
    assert shown[-1]
    detail = target.faults.detail(FaultCode.ZERO_MISSING)
    found = re.search(r"pulses of ([\d.]+) mV \(limit 12 mV\)", detail)
    assert found is not None
    assert float(found[1]) == pytest.approx(20.0, abs=0.5)


def test_the_operators_zero_ends_it() -> None:
    target = monitor(QUICK)
    frames = replace(EMPTY_ELEVATOR, paddle_vibration_mv=20.0).frames(45)
    feed(target, frames[: len(frames) // 2])
    assert FaultCode.ZERO_MISSING in target.records[-1].faults
    target.calibrate_zero()
    feed(target, frames[len(frames) // 2 :])
    assert FaultCode.ZERO_MISSING not in target.records[-1].faults
    assert target.records[-1].zero_mv == pytest.approx(ZERO_MV, abs=1.0)


def test_grain_from_the_first_second_is_the_same_fault() -> None:
    target = monitor(QUICK)
    feed(target, replace(STEADY, flow=lambda t: 10.0).run(20))
    assert FaultCode.ZERO_MISSING in target.records[-1].faults


def test_a_quiet_start_is_none() -> None:
    target = monitor(QUICK)
    feed(target, STEADY.run(30))
    assert not any(FaultCode.ZERO_MISSING in record.faults for record in target.records)


def test_a_ticket_that_contradicts_widens_what_the_open_load_holds() -> None:
    target = monitor(estimator=ForceProportional(relative_std_dev=0.01))
    frames = STEADY.frames(60)
    first, load, ticket = (round(share * len(frames)) for share in (0.2, 0.5, 0.8))
    feed(target, frames[:first])
    target.start_load()
    feed(target, frames[first:load])
    weighed = target.open_load
    target.start_load()
    feed(target, frames[load:ticket])
    before = target.open_load
    assert weighed is not None
    assert before is not None
    target.ticket(weighed.number, 1.25 * weighed.measured_kg, 5.0)
    results = [result for frame in frames[ticket:] for result in target.feed(frame)]
    after = target.open_load
    assert after is not None
    assert FaultCode.SCALE_DISAGREES in target.records[-1].faults
    assert before.std_dev_kg < 0.06 * before.measured_kg
    # Weighed 25 % more than measured: what the load held then, and the one that was weighed, are unsure by as much.
    assert after.budget.parameters_kg == pytest.approx(0.25 * before.measured_kg, rel=0.2)
    closed = {load.number: load for load in target.loads}
    assert closed[weighed.number].budget.parameters_kg == pytest.approx(0.25 * weighed.measured_kg)
    restated = [event.load.number for result in results for event in result.events if isinstance(event, LoadClosed)]
    assert weighed.number in restated


@pytest.mark.parametrize("error_kg", [0.0, 0.5, 50.0])
def test_a_load_is_widened_once_by_what_is_found_out(error_kg: float) -> None:
    loads = Loads(EngineSettings())
    loads.totals = Totals().with_mass(100.0, None, FlowBudget(1.0, 1.0), 1.0)
    for _ in range(2):
        loads.widen(error_kg)
    assert loads.totals.load_budget.parameters_kg == max(1.0, error_kg)
    assert loads.totals.total_budget.parameters_kg == max(1.0, error_kg)
    loads.stop(0.0)
    loads.widen(1000.0)
    assert loads.totals.load_budget.parameters_kg == max(1.0, error_kg)
