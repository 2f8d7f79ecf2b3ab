"""Short seasons under each way of keeping the calibration; the full one is python -m studies.season."""

from __future__ import annotations

import numpy as np
import pytest

from studies.season import season as seasons
from studies.season import study
from yieldmon.physics.machine import Machine
from yieldmon.plant.scenario import Scenario

SEED = 20261121
HOURS = 1.0
SETTINGS = study.StudySettings(day_s=600.0)
"""Six days of ten minutes."""


@pytest.fixture(scope="module")
def outcomes() -> list[study.Outcome]:
    harvest = seasons.SeasonSettings(hours=HOURS)
    scenario = study.scenario_of(harvest).model_copy(update={"effects": Scenario().effects})
    season = seasons.simulate(harvest, Machine(), scenario, SEED)
    first = study.first_calibration(harvest, Machine(), SEED)
    return [study.run(season, first, strategy, SETTINGS) for strategy in study.STRATEGIES]


def test_each_lesson_betters_the_season(outcomes: list[study.Outcome]) -> None:
    never, mapped, swept, ticketed, weighed = (o.mean_abs_load_error_pct for o in outcomes)
    assert never > mapped > swept > ticketed > weighed


def test_only_those_who_sweep_have_swept_and_history_is_kept(outcomes: list[study.Outcome]) -> None:
    assert [o.sweeps > 0 for o in outcomes] == [False, False, True, True, True]
    for outcome in outcomes:
        assert np.all(np.diff(outcome.history["time_h"]) >= 0.0)
        assert len(outcome.history["friction_sd"]) == len(outcome.history["time_h"])


def test_posting_betters_the_days_with_a_ticket_and_touches_no_other_strategy(outcomes: list[study.Outcome]) -> None:
    for outcome in (*outcomes[:3], outcomes[4]):
        assert np.array_equal(outcome.posted_error_pct, outcome.load_error_pct)
    ticketed = outcomes[3]
    assert np.mean(np.abs(ticketed.posted_error_pct)) < 0.8 * ticketed.mean_abs_load_error_pct


def test_shares_by_thirds_make_the_whole(outcomes: list[study.Outcome]) -> None:
    for outcome in outcomes:
        sizes = [len(part) for part in np.array_split(outcome.load_error_pct, 3)]
        whole = np.dot(outcome.within_1_pct_by_third, sizes) / sum(sizes)
        assert whole == pytest.approx(outcome.loads_within_1_pct)
