"""The law of standard deviations over their level, from stated ones."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.fitting.scatter_law import scatter_law

LEVEL = np.array([0.0, 5.0, 20.0, 40.0, -60.0])


@pytest.mark.parametrize(("constant", "proportional"), [(0.5, 0.03), (2.0, 0.0), (0.1, 0.2)])
def test_exact_laws_are_found(constant: float, proportional: float) -> None:
    found = scatter_law(LEVEL, np.hypot(constant, proportional * LEVEL))
    assert found == (pytest.approx(constant, rel=1e-6), pytest.approx(proportional, rel=1e-6, abs=1e-6))


@pytest.mark.parametrize(
    ("level", "sd", "expected"),
    [
        (np.full(4, 7.0), np.full(4, 0.7), (0.7, 0.0)),
        (np.array([1.0, 10.0]), np.array([3.0, 1.0]), (np.sqrt(5.0), 0.0)),
    ],
    ids=["one level", "falling with level"],
)
def test_without_a_rise_the_law_is_constant(level: np.ndarray, sd: np.ndarray, expected: tuple[float, float]) -> None:
    assert scatter_law(level, sd) == pytest.approx(expected)


def test_no_reading_near_zero_is_exact() -> None:
    level = np.array([1.0, 10.0, 30.0])
    constant, proportional = scatter_law(level, 0.05 * level)
    assert proportional == pytest.approx(0.05)
    assert constant == pytest.approx(0.01 * np.sqrt(np.mean((0.05 * level) ** 2)))
