"""Parameter sets that no grain and no calibration can have."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon import api

GRAIN = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
TWO = ("friction", "density")


@pytest.mark.parametrize(
    ("values", "matrix", "message"),
    [
        ({"density": -1100.0}, np.eye(2), "density is -1100; expected a number above 0"),
        ({"density": 0.0}, np.eye(2), "density is 0; expected a number above 0"),
        ({"shape_ratio": -2.0}, np.eye(2), "shape_ratio is -2; expected a number above 0"),
        ({"friction": float("nan")}, np.eye(2), "friction is nan; expected a number"),
        ({"gravity.acceleration_m_s2": float("inf")}, np.eye(2), "gravity.acceleration_m_s2 is inf; expected a number"),
        ({}, [[1.0, 0.0], [0.0, float("nan")]], "not finite"),
        ({}, [[1.0, 0.5], [0.0, 1.0]], "not symmetric"),
        ({}, [[1.0, 0.0], [0.0, -1.0]], "negative variance"),
        ({}, [[1.0, 2.0], [2.0, 1.0]], "friction and density: 2 with variances 1 and 1; expected a correlation from -1 to 1"),
        ({}, [[0.0, 2.0], [2.0, 1.0]], "expected a correlation from -1 to 1"),
    ],
)
def test_what_nothing_can_have_is_refused(values: dict[str, float], matrix: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        api.ParameterSet({**GRAIN, **values}, TWO, np.array(matrix))


def test_correlations_that_cannot_all_be_are_refused() -> None:
    matrix = np.array([[1.0, 0.9, 0.9], [0.9, 1.0, -0.9], [0.9, -0.9, 1.0]])
    with pytest.raises(ValueError, match=r"cannot all be: their lowest eigenvalue is -0\.8"):
        api.ParameterSet(GRAIN, (*TWO, "restitution"), matrix)


def test_a_known_parameter_and_a_restitution_below_0_are_no_mistakes() -> None:
    """A search along the scale passes through the second."""
    known = api.ParameterSet({**GRAIN, "restitution": -0.1}, TWO, np.array([[0.0, 0.0], [0.0, 1.0]]))
    assert known.standard_deviation("friction") == 0.0


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ({"frction": 0.3}, "parameter 'frction': unknown; expected one of friction, density"),
        ({"gravity.acceleration": 9.81}, r"effect parameter 'gravity\.acceleration': unknown; expected one of acceleration_m_s2"),
    ],
)
def test_a_misspelt_parameter_is_not_passed_over(extra: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        api.ParameterSet({"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0} | extra)
