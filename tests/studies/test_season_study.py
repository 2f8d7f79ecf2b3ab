"""Short seasons under each way of keeping the calibration; the full one is python -m studies.season."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest

from studies.season import season as seasons
from studies.season import study
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.drift_rates import DriftRates
from yieldmon.physics.machine import Machine
from yieldmon.plant.scenario import Scenario

SEED = 20261121
HOURS = 1.0
SETTINGS = study.StudySettings(day_s=600.0)
"""Six days of ten minutes."""


@pytest.fixture(scope="module")
def harvest() -> tuple[seasons.Season, ParameterSet]:
    """The season and the calibration at its start."""
    settings = seasons.SeasonSettings(hours=HOURS)
    scenario = study.scenario_of(settings).model_copy(update={"effects": Scenario().effects})
    return seasons.simulate(settings, Machine(), scenario, SEED), study.first_calibration(settings, Machine(), SEED)


def in_an_hour(settings: study.StudySettings) -> study.StudySettings:
    """What is expected of drift, as much faster as the season drifts: all of its 60 hours' drift lies in one."""
    faster = seasons.SeasonSettings().hours / HOURS
    walk, root = settings.wandering, sqrt(faster)
    return replace(
        settings,
        steady_per_kilotonne={name: rate * faster for name, rate in settings.steady_per_kilotonne.items()},
        wandering=DriftRates(
            {name: rate * root for name, rate in walk.per_root_hour.items()},
            {name: rate * root for name, rate in walk.per_root_kilotonne.items()},
            walk.limit,
        ),
    )


@pytest.fixture(scope="module")
def outcomes(harvest: tuple[seasons.Season, ParameterSet]) -> list[study.Outcome]:
    return [study.run(*harvest, strategy, SETTINGS) for strategy in study.STRATEGIES]


def test_each_source_of_information_reduces_the_season_s_error(outcomes: list[study.Outcome]) -> None:
    never, mapped, swept, ticketed, weighed = (o.mean_abs_load_error_pct for o in outcomes)
    assert never > mapped > swept > ticketed > weighed


def test_only_those_who_sweep_have_swept_and_history_is_kept(outcomes: list[study.Outcome]) -> None:
    assert [o.sweeps > 0 for o in outcomes] == [False, False, True, True, True]
    for outcome in outcomes:
        assert np.all(np.diff(outcome.history["time_h"]) >= 0.0)
        assert len(outcome.history["friction_sd"]) == len(outcome.history["time_h"])


def test_posting_betters_the_days_with_a_ticket_and_touches_no_other_strategy(
    harvest: tuple[seasons.Season, ParameterSet], outcomes: list[study.Outcome]
) -> None:
    for outcome in (*outcomes[:3], outcomes[4]):
        assert np.array_equal(outcome.posted_error_pct, outcome.load_error_pct)
    ticketed = study.run(*harvest, study.STRATEGIES[3], replace(in_an_hour(study.StudySettings.of_daemon()), day_s=600.0))
    assert np.mean(np.abs(ticketed.posted_error_pct)) < 0.8 * ticketed.mean_abs_load_error_pct


def test_shares_by_thirds_make_the_whole(outcomes: list[study.Outcome]) -> None:
    for outcome in outcomes:
        sizes = [len(part) for part in np.array_split(outcome.load_error_pct, 3)]
        whole = np.dot(outcome.within_1_pct_by_third, sizes) / sum(sizes)
        assert whole == pytest.approx(outcome.loads_within_1_pct)
