"""Loads that are as unsure as sweeps show, before a sweep as well as after it."""

from dataclasses import replace
from math import hypot, nan

import pytest

from yieldmon.engine.budget import FlowBudget
from yieldmon.engine.flow import Flow
from yieldmon.engine.loads import LoadClosed, Loads
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.sweep_model_error import NO_ERROR, ModelError
from yieldmon.frames import EstimateQuality

BUDGET = FlowBudget(noise_kg_s=0.3, parameters_kg_s=0.05, covariance_kg_s=0.05, per_error_kg_s=10.0)
FLOW = Flow(10.0, BUDGET.std_dev_kg_s, EstimateQuality.OK, 80.0, 2.0, budget=BUDGET)
SHOWN = ModelError(0.04, 0.1)


def harvest(loads: Loads, seconds: int, version: int = 1, *, at_home: bool = True) -> None:
    for _ in range(seconds):
        loads.totals = loads.totals.with_mass(10.0, None, BUDGET, 1.0)
        loads.share(10.0, FLOW, version, at_home=at_home)


def test_a_load_that_closed_before_a_sweep_is_as_unsure_as_the_sweep_shows() -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.start(60.0)
    harvest(loads, 20)
    harvest(loads, 10, at_home=False)
    first, second = loads.all
    assert first.budget.parameters_kg == pytest.approx(3.0)
    events = loads.restate(SHOWN, 1)
    assert [event.load.number for event in events if isinstance(event, LoadClosed)] == [1]
    first, second = loads.all
    assert first.budget.parameters_kg == pytest.approx(hypot(3.0, 0.04 * 600.0))
    assert first.std_dev_kg == pytest.approx(first.budget.std_dev_kg)
    assert second.budget.parameters_kg == pytest.approx(hypot(1.5, 0.04 * 300.0, 0.1 * 100.0))
    total = loads.totals.total_budget
    assert total.parameters_kg == pytest.approx(first.budget.parameters_kg + second.budget.parameters_kg)
    # A later sweep that shows less is the better judge.
    loads.restate(NO_ERROR, 1)
    assert [load.budget.parameters_kg for load in loads.all] == pytest.approx([3.0, 1.5])
    assert loads.totals.total_budget.parameters_kg == pytest.approx(4.5)


def test_the_same_said_again_is_no_news() -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.start(60.0)
    assert loads.restate(SHOWN, 1)
    assert loads.restate(SHOWN, 1) == ()


def test_what_other_parameters_measured_stays_as_stated() -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.start(60.0)
    harvest(loads, 10)
    harvest(loads, 10, version=2)
    assert loads.restate(SHOWN, 1) == ()
    loads.restate(SHOWN, 2)
    first, second = loads.all
    assert first.budget.parameters_kg == pytest.approx(3.0)
    assert second.budget.parameters_kg == pytest.approx(0.5 + hypot(0.5, 0.04 * 100.0))


def test_a_reset_total_does_not_hold_the_loads_before() -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.reset(60.0)
    harvest(loads, 10)
    loads.restate(SHOWN, 1)
    assert loads.all[0].budget.parameters_kg == pytest.approx(hypot(3.0, 24.0))
    assert loads.totals.total_budget.parameters_kg == pytest.approx(hypot(0.5, 4.0))


def test_the_open_load_is_restated_after_a_restart() -> None:
    before = Loads(EngineSettings())
    harvest(before, 60)
    loads = Loads(EngineSettings())
    loads.restore(before.totals)
    loads.resume_share(NO_ERROR, 1)
    harvest(loads, 10)
    loads.restate(SHOWN, 1)
    assert loads.totals.load_budget.parameters_kg == pytest.approx(hypot(3.5, 0.04 * 700.0))


def test_a_budget_that_is_not_known_stays_so() -> None:
    loads = Loads(EngineSettings())
    unknown = replace(FLOW, budget=FlowBudget(nan, nan, covariance_kg_s=nan, per_error_kg_s=0.0))
    loads.totals = loads.totals.with_mass(10.0, None, unknown.budget, 1.0)
    loads.share(10.0, unknown, 1, at_home=True)
    loads.restate(SHOWN, 1)
    assert loads.totals.load_budget.std_dev_kg != loads.totals.load_budget.std_dev_kg
