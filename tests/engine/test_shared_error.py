"""Loads that are as unsure as sweeps show, before a sweep as well as after it."""

import json
from dataclasses import replace
from math import hypot, isnan, nan, radians

import numpy as np
import pytest

from yieldmon.engine.flow import Flow
from yieldmon.engine.mass.budget import FlowBudget, MassBudget
from yieldmon.engine.mass.load_summary import LoadClosed, LoadRestated
from yieldmon.engine.mass.loads import Loads
from yieldmon.engine.mass.missed_mass import MissedMass
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.state import EngineState
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, NODES_RAD, AngleError
from yieldmon.frames import EstimateQuality
from yieldmon.service.history.load_book import LoadBook
from yieldmon.service.storage.batch import Load

BUDGET = FlowBudget(noise_kg_s=0.3, parameters_kg_s=0.05, covariance_kg_s=0.05, per_error_kg_s=10.0)
FLOW = Flow(10.0, BUDGET.std_dev_kg_s, EstimateQuality.OK, 80.0, 2.0, budget=BUDGET)
HOME_RAD, AWAY_RAD = radians(70.0), radians(40.0)


def one_cause(at_home: float, at_40_deg: float) -> AngleError:
    """One cause of unknown sign that changes the force by so much at home and at 40 deg."""
    change = np.interp(NODES_RAD, [AWAY_RAD, HOME_RAD], [at_40_deg, at_home])
    return AngleError.of(np.outer(change, change), HOME_RAD)


SHOWN = one_cause(0.04, 0.14)


def harvest(loads: Loads, seconds: int, version: int = 1, angle_rad: float = HOME_RAD, error: AngleError = NO_ERROR) -> None:
    for _ in range(seconds):
        loads.totals = loads.totals.with_mass(10.0, None, BUDGET, 1.0)
        loads.share(10.0, FLOW, version, angle_rad, error)


def test_a_load_that_closed_before_a_sweep_is_as_unsure_as_the_sweep_shows() -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.start(60.0)
    harvest(loads, 20)
    harvest(loads, 10, angle_rad=AWAY_RAD)
    first, second = loads.all
    assert first.budget.parameters_kg == pytest.approx(3.0)
    events = loads.restate(SHOWN, 1)
    assert [event.load.number for event in events if isinstance(event, LoadClosed)] == [1]
    first, second = loads.all
    assert first.budget.parameters_kg == pytest.approx(hypot(3.0, 0.04 * 600.0))
    assert first.std_dev_kg == pytest.approx(first.budget.std_dev_kg)
    assert second.budget.parameters_kg == pytest.approx(hypot(1.5, 0.04 * 200.0 + 0.14 * 100.0))
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


def test_an_error_of_one_cause_has_its_signs_in_a_load() -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 30)
    harvest(loads, 30, angle_rad=AWAY_RAD)
    loads.restate(one_cause(0.05, -0.05), 1)
    assert loads.all[0].budget.parameters_kg == pytest.approx(3.0)


def test_what_is_shown_before_a_load_counts_in_it_as_in_one_that_closed_before() -> None:
    before, after = Loads(EngineSettings()), Loads(EngineSettings())
    for loads, error in ((before, NO_ERROR), (after, SHOWN)):
        harvest(loads, 30, error=error)
        harvest(loads, 30, angle_rad=AWAY_RAD, error=error)
    before.restate(SHOWN, 1)
    assert after.totals.load_budget == before.totals.load_budget
    assert after.totals.total_budget.parameters_kg == pytest.approx(before.totals.total_budget.parameters_kg)


@pytest.mark.parametrize("restart", [False, True])
def test_what_was_measured_before_a_sweep_showed_it_keeps_an_error_that_is_known(restart: bool) -> None:
    """Of a load of 600 kg, half of it 30 s at 40 deg, 20 of them before it was taken off."""
    away = np.interp(NODES_RAD, [AWAY_RAD, HOME_RAD], [0.1, 0.0])
    at_home = np.outer(*(np.full(NODES_RAD.size, 0.03),) * 2)
    error = AngleError.of(at_home, HOME_RAD, away, np.full(NODES_RAD.size, 0.03))
    loads = Loads(EngineSettings())
    harvest(loads, 30)
    harvest(loads, 20, angle_rad=AWAY_RAD)
    loads.restate(error, 1)
    corrected = replace(FLOW, budget=replace(BUDGET, taken_off=0.1))
    for _ in range(10):
        loads.totals = loads.totals.with_mass(10.0, None, BUDGET, 1.0)
        loads.share(10.0, corrected, 1, AWAY_RAD, error)
    if restart:
        loads = resumed(loads)
        loads.restate(error, 1)
    # Of one sign with the error that all of it has.
    assert loads.totals.load_budget.parameters_kg == pytest.approx(hypot(3.0, 0.03 * 600.0 + 0.1 * 200.0))
    loads.restate(NO_ERROR, 1)
    assert loads.totals.load_budget.parameters_kg == pytest.approx(hypot(3.0, 0.1 * 100.0)), "what was taken off, for nothing"


def test_the_open_load_is_restated_after_a_restart() -> None:
    before = Loads(EngineSettings())
    harvest(before, 60)
    loads = Loads(EngineSettings())
    loads.restore(before.totals)
    loads.resume_share(NO_ERROR, 1, HOME_RAD)
    harvest(loads, 10)
    loads.restate(SHOWN, 1)
    assert loads.totals.load_budget.parameters_kg == pytest.approx(hypot(3.5, 0.04 * 700.0))


@pytest.mark.parametrize("error", [NO_ERROR, SHOWN], ids=["no error of the model", "one that sweeps had shown"])
def test_what_a_load_shares_is_known_again_after_a_restart(error: AngleError) -> None:
    before = Loads(EngineSettings())
    harvest(before, 60)
    before.restate(error, 1)
    stated_kg = before.totals.load_budget.parameters_kg
    loads = Loads(EngineSettings())
    loads.restore(before.totals)
    loads.resume_share(error, 1, HOME_RAD)
    loads.restate(error, 1)
    assert loads.totals.load_budget.parameters_kg == pytest.approx(stated_kg)
    loads.restate(NO_ERROR, 1)
    assert loads.totals.load_budget.parameters_kg == pytest.approx(3.0)


@pytest.mark.parametrize("is_open", [True, False])
@pytest.mark.parametrize("what", ["corrected", "widened"])
def test_what_was_found_out_of_one_load_otherwise_is_not_restated(what: str, is_open: bool) -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    if what == "widened":
        loads.widen(90.0)
    if not is_open:
        loads.start(60.0)
        harvest(loads, 10)
    if what == "corrected":
        loads.correct({1: MissedMass(kg=60.0)})
    before = loads.all[0].budget.parameters_kg
    assert before == pytest.approx(90.0 if what == "widened" else 3.3)
    loads.restate(SHOWN, 1)
    assert loads.all[0].budget.parameters_kg == before
    if not is_open:
        assert loads.all[1].budget.parameters_kg == pytest.approx(hypot(0.5, 4.0)), "another load is"


@pytest.mark.parametrize("restart", [False, True])
def test_a_weighed_mass_shows_what_all_loads_of_the_scale_are_off_by(restart: bool) -> None:
    """Whichever parameters measured them since it was set, a sweep's among them; until the ticket is taken back."""
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.scale_is_set()
    loads.start(60.0)
    harvest(loads, 60)
    loads.start(120.0)
    harvest(loads, 60, version=2)
    loads.start(180.0)
    harvest(loads, 10, version=2)
    stated = {load.number: load.budget.parameters_kg for load in loads.all}
    assert stated == {n: pytest.approx(kg) for n, kg in ((1, 3.0), (2, 3.0), (3, 3.0), (4, 0.5))}
    if restart:
        loads = resumed(loads, 2)
    events = loads.scale_is_off(0.2, by_load=2)
    known = {state.number: state.budget.parameters_kg for state in loads.closed_states}
    assert known == {n: pytest.approx(kg) for n, kg in ((1, 3.0), (2, 120.0), (3, 120.0), (4, 20.0))}
    assert {e.number if isinstance(e, LoadRestated) else e.load.number for e in events} == {2, 3}
    assert loads.totals.total_budget.parameters_kg == pytest.approx(263.0)
    loads.scale_is_set()
    assert loads.scale_is_off(0.3, by_load=3) == ()
    harvest(loads, 10, version=3)
    loads.restate(SHOWN, 3)
    if restart:
        loads = resumed(loads, 3)
    assert loads.scale_was_right({7}) == ()
    loads.scale_was_right({2})
    loads.restate(NO_ERROR, 3)
    known = {state.number: state.budget.parameters_kg for state in loads.closed_states}
    assert known == {n: pytest.approx(kg) for n, kg in ((1, 3.0), (2, 3.0), (3, 3.0), (4, 1.0))}
    assert loads.totals.total_budget.parameters_kg == pytest.approx(10.0)


@pytest.mark.parametrize("restart", [False, True])
def test_a_scale_that_a_ticket_showed_to_be_off_is_doubted_again_by_another_once_that_ticket_is_taken_back(restart: bool) -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.scale_is_off(0.1, by_load=1)
    loads.scale_is_set()
    if restart:
        loads.stop(60.0)
        loads = resumed(loads)
    loads.scale_is_off(0.1, by_load=2)
    assert loads.totals.load_budget.parameters_kg == pytest.approx(60.0), "of the scale that was set nothing is measured yet"
    loads.scale_was_right({1})
    assert loads.totals.load_budget.parameters_kg == pytest.approx(3.0)
    loads.scale_is_off(0.2, by_load=2)
    assert loads.totals.load_budget.parameters_kg == pytest.approx(120.0)


@pytest.mark.parametrize("restart", [False, True])
def test_a_scale_that_a_wrong_ticket_found_right_is_doubted_by_the_right_one(restart: bool) -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.stop(60.0)
    loads.scale_is_set([1])
    if restart:
        loads = resumed(loads)
    loads.scale_is_set()
    assert loads.scale_was_right({1}) == ()
    loads.scale_is_off(0.2, by_load=1)
    assert loads.totals.load_budget.parameters_kg == pytest.approx(120.0)


def test_a_scale_is_doubted_by_the_weights_of_its_own_crop_over_a_restart() -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.stop(60.0)
    loads.change_crop("corn", "wheat")
    loads.start(70.0)
    harvest(loads, 60)
    loads.stop(130.0)
    loads = resumed(loads)
    loads.scale_is_off(0.3, by_load=2)
    loads.change_crop("wheat", "corn")
    loads.scale_is_off(0.2, by_load=1)
    known = {state.number: state.budget.parameters_kg for state in loads.closed_states}
    assert known == {1: pytest.approx(120.0), 2: pytest.approx(180.0)}


def test_tickets_of_another_crop_that_are_taken_back_say_nothing_of_the_loads_that_the_scale_in_use_has_measured() -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.scale_is_off(0.2, by_load=1)
    loads.scale_is_set([1])
    loads.stop(60.0)
    loads.change_crop("corn", "wheat")
    loads.scale_was_right({1}, crop="corn")
    assert loads.scale_is_off(0.5, by_load=2) == ()
    loads.change_crop("wheat", "corn")
    loads.scale_is_off(0.1, by_load=1)
    assert loads.totals.load_budget.parameters_kg == pytest.approx(60.0)


def test_what_a_doubted_ticket_made_of_the_open_load_goes_with_it() -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    loads.widen(90.0, by_load=7)
    harvest(loads, 60)
    assert loads.totals.load_budget.parameters_kg == pytest.approx(93.0)
    loads.forget_weights({7})
    assert loads.totals.load_budget.parameters_kg == loads.totals.total_budget.parameters_kg == pytest.approx(6.0)


def test_totals_that_were_kept_know_nothing_of_what_was_measured_before_them() -> None:
    loads = Loads(EngineSettings())
    harvest(loads, 60)
    (state,) = loads.closed_states
    assert (state.shared is not None, state.of_scale_kg) == (True, pytest.approx(600.0))
    loads.restore(loads.totals)
    (state,) = loads.closed_states
    assert (state.shared, state.of_scale_kg, state.shown) == (None, 0.0, ())


def test_a_budget_that_is_not_known_stays_so() -> None:
    loads = Loads(EngineSettings())
    unknown = replace(FLOW, budget=FlowBudget(nan, nan, covariance_kg_s=nan, per_error_kg_s=0.0))
    loads.totals = loads.totals.with_mass(10.0, None, unknown.budget, 1.0)
    loads.share(10.0, unknown, 1, HOME_RAD)
    loads.restate(SHOWN, 1)
    assert isnan(loads.totals.load_budget.std_dev_kg)


def resumed(before: Loads, version: int = 1) -> Loads:
    """The same after a restart, by way of JSON; version: of the parameters in use then."""
    document = json.dumps(EngineState(totals=before.totals, closed=before.closed_states).as_dict())
    state = EngineState.from_dict(json.loads(document))
    loads = Loads(EngineSettings())
    loads.restore(state.totals)
    loads.resume_closed(state.closed, version)
    loads.resume_share(NO_ERROR, version, HOME_RAD)
    return loads


def test_a_load_that_closed_before_a_restart_is_restated_as_without_it() -> None:
    before = Loads(EngineSettings())
    harvest(before, 60)
    before.start(60.0)
    harvest(before, 30, angle_rad=AWAY_RAD)
    before.stop(90.0)
    loads = resumed(before)
    (without,), events = before.restate(one_cause(0.0, 0.1), 1), loads.restate(one_cause(0.0, 0.1), 1)
    assert isinstance(without, LoadClosed)
    assert [(event.number, event.std_dev_kg) for event in events] == [(2, pytest.approx(without.load.std_dev_kg))]
    before.restate(SHOWN, 1)
    expected = {load.number: pytest.approx(load.std_dev_kg) for load in before.all}
    assert {event.number: event.std_dev_kg for event in loads.restate(SHOWN, 1) if isinstance(event, LoadRestated)} == expected
    assert loads.totals.total_budget.std_dev_kg == pytest.approx(before.totals.total_budget.std_dev_kg)
    # And over one more.
    again = resumed(loads)
    assert again.restate(SHOWN, 1) == ()
    assert {event.number for event in again.restate(NO_ERROR, 1) if isinstance(event, LoadRestated)} == {1, 2}


def test_a_load_that_was_kept_without_its_angles_stays_as_stated() -> None:
    before = Loads(EngineSettings())
    harvest(before, 60)
    before.start(60.0)
    document = EngineState(totals=before.totals, closed=before.closed_states).as_dict()
    (load,) = document["closed"]
    load["shared"] = {"version": 1, "before_kg": 0.0, "own_kg": 3.0, "per_error_kg": 600.0, "per_error_away_kg": 0.0}
    loads = Loads(EngineSettings())
    loads.resume_closed(EngineState.from_dict(json.loads(json.dumps(document))).closed, 1)
    assert loads.restate(SHOWN, 1) == ()


@pytest.mark.parametrize("version", [1, 2])
def test_a_load_that_is_known_again_after_a_restart_has_the_budget_that_it_was_stated_with(version: int) -> None:
    """Also where other parameters are in use by then; without it what sweeps may show would count as the zero's."""
    before = Loads(EngineSettings())
    harvest(before, 60)
    before.start(60.0)
    before.restate(SHOWN, 1)
    stated = before.all[0]
    loads = resumed(before, version)
    whole = MassBudget(stated.budget.noise_kg2, 0.0, stated.std_dev_kg)
    assert loads.as_stated(replace(stated, budget=whole)) == stated
    other = replace(stated, number=99, budget=whole, std_dev_kg=whole.std_dev_kg)
    assert loads.as_stated(other) == other


def test_what_an_open_load_was_measured_at_outlives_a_restart() -> None:
    before = Loads(EngineSettings())
    harvest(before, 30)
    harvest(before, 30, angle_rad=AWAY_RAD)
    loads = resumed(before)
    for one in (before, loads):
        one.restate(SHOWN, 1)
    assert loads.totals.load_budget == before.totals.load_budget
    loads.start(60.0)
    before.start(60.0)
    known = {load.number: load.std_dev_kg for load in before.all}
    events = loads.restate(NO_ERROR, 1)
    before.restate(NO_ERROR, 1)
    assert {load.number: load.std_dev_kg for load in before.all} != known
    assert {e.load.number for e in events if isinstance(e, LoadClosed)} == {1}


def test_other_parameters_after_a_restart_leave_it_as_stated() -> None:
    before = Loads(EngineSettings())
    harvest(before, 60)
    before.start(60.0)
    assert resumed(before, version=2).restate(SHOWN, 2) == ()


def test_a_restated_load_is_so_in_the_book() -> None:
    known = Load(1, "", "corn", 0.0, 60.0, 600.0, None, None, 3.0)
    book = LoadBook([known])
    budget = MassBudget(parameters_kg=24.2)
    book.restated(1, budget)
    book.restated(9, budget)
    assert book.take() == (replace(known, std_dev_kg=24.2, budget=budget),)
