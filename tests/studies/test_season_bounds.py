"""What could be had right live by tickets, and what the live error is made of, over a season of an hour."""

from __future__ import annotations

from dataclasses import replace

import pytest

from studies.season import season as seasons
from studies.season import study
from studies.season.best_live import best_live
from studies.season.live_causes import live_causes
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
    told = [found[name] for name in ("no sweeps", "sweeps", "a sweep with every load", "ratios known")]
    assert told == sorted(told)
    assert found["no sweeps"] <= found["friction known"]
    more = [found["no sweeps"], *(found[f"no sweeps, {count} tickets a day"] for count in (2, 4, 8))]
    assert more == sorted(more)
    assert more[-1] > more[0]
    assert found["no sweeps, posted"] > found["no sweeps"]


def test_with_all_that_is_true_a_load_is_measured_as_it_is(harvest: tuple[seasons.Season, ParameterSet]) -> None:
    found = live_causes(*harvest, KEPT)
    strategy = study.Strategy("map and ticket", moisture_map=True, tickets_per_day=1)
    by_study = study.run(*harvest, strategy, KEPT)
    assert found["as measured"]["mean_abs_pct"] == pytest.approx(by_study.mean_abs_load_error_pct, abs=0.1)
    assert found["grain, wear, zero and noise"]["mean_abs_pct"] < 0.5
    assert found["as measured"]["mean_abs_pct"] > 1.0
