"""The best that mean force and pulse shape can do over the drift of the daemon's seasons, and how near the daemon comes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from studies.waveform import season_bound, season_causes
from studies.waveform.daemon_season import LOADS


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    return season_bound.report()


def test_the_draws_are_those_of_the_seasons() -> None:
    drawn = season_causes.draws(17003)
    assert drawn.signs.tolist() == [-1.0, -1.0]
    assert drawn.flows_kg_s.shape == (LOADS,)
    assert np.all((drawn.flows_kg_s > 7.0) & (drawn.flows_kg_s < 13.0))


@pytest.mark.parametrize("law", ["daemon", "steady, normal"])
def test_of_what_fill_and_force_tell_density_has_the_share_of_its_variance(law: str) -> None:
    told = np.linspace(0.0, 0.2, LOADS)
    drifts = np.array([season_bound.DRIFT, season_bound.GAIN_DRIFT]) ** 2
    expected = drifts[0] / drifts.sum() * told
    assert season_bound.posterior_of_density(law, told)[8:] == pytest.approx(expected[8:], rel=0.02)


def test_no_law_that_is_not_told_the_sizes_halves_the_error_where_the_two_drift_against_each_other(found: dict[str, Any]) -> None:
    for law in ("daemon", "steady, normal", "steady, even", "a share"):
        row = found["bounds"][law]
        assert row["seasons_halved"] == row["of_them_alike"] == found["seasons_alike"]
        assert row["against_pct"] > found["bounds"]["mean force"]["against_pct"]


def test_the_daemon_is_at_the_bound_of_its_own_law(found: dict[str, Any]) -> None:
    for season in found["daemon"].values():
        assert season["e"]["mean_pct"] == pytest.approx(season["bound"]["daemon"]["mean_pct"], rel=0.03)
        assert season["bound"]["daemon"]["over_b"] > 0.7


def test_a_density_told_to_two_per_cent_would_halve_it(found: dict[str, Any]) -> None:
    assert found["daemon_law_with_density_told"]["2 %"]["mean_pct"] < 0.5 * found["daemon"]["daemon_season.json"]["b"]["mean_pct"]
