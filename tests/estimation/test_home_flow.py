"""Flow between visits home: exact where it runs straight, honest about the rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.estimation.self_calibration.home_flow import Visits, bracketed, covariance, wander_per_s

TIME_S = np.array([0.0, 1.0, 14.0, 15.0, 28.0, 29.0])
SD = np.full(6, 0.02)


def visits(flow: np.ndarray) -> Visits:
    return Visits.of(TIME_S, flow, SD)


def test_windows_next_to_each_other_are_one_visit() -> None:
    found = visits(np.array([8.0, 8.0, 10.0, 10.0, 9.0, 9.0]))
    assert found.time_s == pytest.approx([0.5, 14.5, 28.5])
    assert np.exp(found.log_flow) == pytest.approx([8.0, 10.0, 9.0])
    assert found.sd == pytest.approx([0.02 / np.sqrt(2.0)] * 3)


@given(start=st.floats(1.0, 20.0), growth=st.floats(-0.02, 0.02), at=st.floats(0.6, 28.4))
def test_exponential_flow_is_found_exactly(start: float, growth: float, at: float) -> None:
    value, sd = bracketed(visits(start * np.exp(growth * TIME_S)), np.array([at]), 0.0)
    assert np.exp(value[0]) == pytest.approx(start * np.exp(growth * at), rel=1e-9)
    assert 0.0 < sd[0] <= 0.02 / np.sqrt(2.0) * (1.0 + 1e-9)


@pytest.mark.parametrize("at", [0.0, 29.5], ids=["before the first visit", "after the last"])
def test_nothing_is_reported_outside(at: float) -> None:
    value, sd = bracketed(visits(np.full(6, 9.0)), np.array([at]), 0.0)
    assert np.isnan(value[0])
    assert np.isnan(sd[0])


def test_windows_at_home_are_judged_by_the_other_visits() -> None:
    flow = np.array([8.0, 8.0, 99.0, 99.0, 8.0, 8.0])
    value, _ = bracketed(visits(flow), TIME_S, 0.0, at_home=np.ones(6, dtype=bool))
    assert np.exp(value[2:4]) == pytest.approx([8.0, 8.0])
    assert np.isnan(value[[0, 1, 4, 5]]).all()


def test_a_wandering_flow_is_least_known_in_the_middle() -> None:
    _, sd = bracketed(visits(np.full(6, 9.0)), np.array([0.6, 7.5, 14.4]), 1e-4)
    assert sd[1] == pytest.approx(np.sqrt(0.5 * 0.02**2 / 2.0 + 1e-4 * 14.0 / 4.0))
    assert sd[1] > sd[0]
    assert sd[1] > sd[2]


@pytest.mark.parametrize("true", [0.0, 2e-4])
def test_the_wander_is_found_among_the_noise(true: float) -> None:
    rng = np.random.default_rng(3)
    time_s = 14.0 * np.arange(6)
    found = wander_per_s(
        [
            Visits(
                time_s,
                np.cumsum(np.sqrt(14.0 * true) * rng.standard_normal(6)) + 0.02 * rng.standard_normal(6),
                np.full(6, 0.02),
            )
            for _ in range(400)
        ]
    )
    assert found == pytest.approx(true, abs=1e-5)


def test_unknown_flow_makes_no_visit() -> None:
    assert len(visits(np.array([np.nan, 0.0, 9.0, 9.0, np.nan, -1.0]))) == 1
    assert len(Visits.of(np.zeros(0), np.zeros(0), np.zeros(0))) == 0


def test_errors_that_visits_share_are_those_of_many_simulated_sweeps() -> None:
    """Random walks seen at home with noise; errors of the flows between, over 20,000 of them."""
    rng, wander, sd, count = np.random.default_rng(5), 2e-4, 0.02, 20_000
    home_s, away_s = np.array([0.0, 15.0, 30.0]), np.array([5.0, 10.0, 20.0])
    order = np.argsort(np.concatenate((home_s, away_s)))
    time_s = np.concatenate((home_s, away_s))[order]
    walk = np.cumsum(rng.standard_normal((count, time_s.size)) * np.sqrt(wander * np.diff(time_s, prepend=0.0)), axis=1)
    at_home, away = np.isin(time_s, home_s), np.isin(time_s, away_s)
    seen = walk[:, at_home] + sd * rng.standard_normal((count, 3))
    error = np.array([np.interp(away_s, home_s, row) for row in seen]) - walk[:, away]
    reported = covariance(Visits(home_s, np.zeros(3), np.full(3, sd)), away_s, wander)
    np.testing.assert_allclose(reported, np.cov(error.T), atol=0.03 * reported.max())
    one = bracketed(Visits(home_s, np.zeros(3), np.full(3, sd)), away_s, wander)[1]
    np.testing.assert_allclose(np.sqrt(np.diag(reported)), one)


def test_nothing_is_reported_of_errors_outside() -> None:
    reported = covariance(visits(np.full(6, 9.0)), np.array([0.0, 20.0, 29.5]), 1e-4)
    assert np.array_equal(np.isfinite(reported), np.outer([False, True, False], [False, True, False]))
