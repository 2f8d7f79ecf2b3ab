"""The report on cases by other laws: its figures for names whose probabilities are known."""

from __future__ import annotations

import numpy as np
import pytest

from studies.hidden_effects import law_report
from studies.hidden_effects.confidence_map import expected_calibration_error

STATED = np.random.default_rng(12).uniform(0.2, 0.95, 4000)


def right(probability: np.ndarray) -> np.ndarray:
    return (np.random.default_rng(13).random(len(probability)) < probability).astype(float)


def test_names_that_are_right_as_stated_lie_on_the_line_and_within_chance() -> None:
    truth = right(STATED)
    slope, intercept, p = law_report.calibration_line(STATED, truth)
    assert (slope, intercept) == (pytest.approx(1.0, abs=0.1), pytest.approx(0.0, abs=0.1))
    assert p > 0.05
    assert expected_calibration_error(STATED, truth) < np.quantile(law_report.by_chance(STATED), 0.99)


@pytest.mark.parametrize(("slope", "intercept"), [(0.5, 0.0), (1.0, 0.7), (1.6, -0.4)])
def test_the_line_gives_back_how_stated_probabilities_err(slope: float, intercept: float) -> None:
    odds = slope * np.log(STATED / (1.0 - STATED)) + intercept
    truth = right(1.0 / (1.0 + np.exp(-odds)))
    found = law_report.calibration_line(STATED, truth)
    assert found[:2] == (pytest.approx(slope, abs=0.12), pytest.approx(intercept, abs=0.12))
    assert found[2] < 1e-6
    assert expected_calibration_error(STATED, truth) > law_report.by_chance(STATED).max()


def test_chance_makes_less_of_an_error_with_more_names() -> None:
    few, many = (law_report.by_chance(STATED[:count]).mean() for count in (100, 1600))
    assert few == pytest.approx(4.0 * many, rel=0.25)
