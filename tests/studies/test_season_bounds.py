"""What could be had right live by tickets, and what the live error is made of, over a season of an hour."""

from __future__ import annotations

from dataclasses import replace

import pytest

from studies.season import season as seasons
from studies.season import study
from studies.season.best_live import best_live
from studies.season.home_flow import home_flow
from studies.season.live_causes import live_causes, live_parts
from studies.season.sweep_readings import sweep_readings
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine
from yieldmon.plant.scenario import Scenario

SEED = 33
SETTINGS = seasons.SeasonSettings(hours=1.0, load_kg=(1500.0, 3000.0))
KEPT = replace(study.StudySettings.of_daemon(), day_s=1200.0)


@pytest.fixture(scope="module")
def harvest() -> tuple[seasons.Season, ParameterSet]:
    scenario = study.scenario_of(SETTINGS).model_copy(update={"effects": Scenario().effects})
    return seasons.simulate(SETTINGS, Machine(), scenario, SEED), study.first_calibration(SETTINGS, Machine(), SEED)


def test_what_is_told_beside_tickets_raises_the_share_that_can_be_right(harvest: tuple[seasons.Season, ParameterSet]) -> None:
    found = best_live(*harvest, SETTINGS, KEPT)
    told = [found[name] for name in ("no sweeps", "sweeps as they read", "sweeps", "a sweep with every load", "ratios known")]
    assert told == sorted(told)
    assert found["no sweeps"] <= found["friction known"]
    more = [found["no sweeps"], *(found[f"no sweeps, {count} tickets a day"] for count in (2, 4, 8))]
    assert more == sorted(more)
    assert more[-1] > more[0]
    assert found["no sweeps, posted"] > found["no sweeps"]
    # Of many seasons the one told more is off by less; of each by itself it is not.
    alone, swept = found["mean_pct, no sweeps and sweeps as they read"]
    assert swept <= alone
    assert 0.0 < found["seasons that sweeps as they read make worse"] < 0.5


def test_with_all_that_is_true_a_load_is_measured_as_it_is(harvest: tuple[seasons.Season, ParameterSet]) -> None:
    found = live_causes(*harvest, KEPT)
    strategy = study.Strategy("map and ticket", moisture_map=True, tickets_per_day=1)
    by_study = study.run(*harvest, strategy, KEPT)
    assert found["as measured"]["mean_abs_pct"] == pytest.approx(by_study.mean_abs_load_error_pct, abs=0.1)
    assert found["grain, wear, zero and noise"]["mean_abs_pct"] < 0.5
    assert found["as measured"]["mean_abs_pct"] > 1.0


def test_the_parts_of_the_live_error_are_those_of_its_whole(harvest: tuple[seasons.Season, ParameterSet]) -> None:
    found, causes = live_parts(*harvest, KEPT), live_causes(*harvest, KEPT)
    # Logarithms there, relative errors of 5 % here.
    assert found["all"]["mean_abs_pct"] == pytest.approx(causes["as measured"]["mean_abs_pct"], rel=0.06)
    assert found["model"]["rms_pct"] < 0.5, "what is left where parameters, zero and noise are right"
    assert found["scale and drift"]["mean_abs_pct"] < 0.5 * found["all"]["mean_abs_pct"]


def test_sweeps_read_friction_as_well_as_they_state(harvest: tuple[seasons.Season, ParameterSet]) -> None:
    season, _ = harvest
    found = sweep_readings(season, 2.0, replace(KEPT, sweep_interval_s=60.0, steady_cv=0.2))
    assert found["sweeps"] >= 10
    assert abs(found["score_mean"]) < 4.0 * found["score_mean_sd"]
    assert 0.6 < found["score_rms"] < 1.5


def test_the_copy_of_the_filter_keeps_the_flow_at_home_only_where_it_is_told_to(
    harvest: tuple[seasons.Season, ParameterSet],
) -> None:
    kept = replace(KEPT, sweep_interval_s=120.0)
    right, off = (home_flow(*harvest, SETTINGS, kept, seasons=4, common_error=error) for error in (0.0, 0.05))
    assert right["steady, tickets"] == off["steady, tickets"], "a ticket is of the plate at home"
    moved = {way: abs(off[f"mean of laws, {way}"][0] - right[f"mean of laws, {way}"][0]) for way in ("sweeps", "constrained")}
    assert 0.0 < moved["constrained"] < moved["sweeps"]
