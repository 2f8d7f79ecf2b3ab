"""Elementary functions that carry a perturbation to first order, against complex functions and finite differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import special

from yieldmon.physics import numerics

AT = np.linspace(-0.9, 0.9, 13)


@pytest.mark.parametrize(
    ("ours", "reference", "at"),
    [
        (numerics.exp, np.exp, AT),
        (lambda x: numerics.sin_cos(x)[0], np.sin, AT),
        (lambda x: numerics.sin_cos(x)[1], np.cos, AT),
        (numerics.arccos, np.arccos, AT),
        (numerics.arctan, np.arctan, 5.0 * AT),
        (numerics.erf, special.erf, 3.0 * AT),
        (numerics.sqrt, np.sqrt, AT + 1.0),
    ],
)
def test_value_and_slope(ours: Callable, reference: Callable, at: np.ndarray) -> None:
    np.testing.assert_array_equal(ours(at), reference(at))
    carried = ours(at + 1j * numerics.COMPLEX_STEP)
    np.testing.assert_array_equal(carried.real, reference(at))
    step = 1e-6
    slope = (reference(at + step) - reference(at - step)) / (2.0 * step)
    np.testing.assert_allclose(carried.imag / numerics.COMPLEX_STEP, slope, rtol=1e-6, atol=1e-8)


def test_no_slope_is_carried_where_it_has_no_bound() -> None:
    assert np.isfinite(numerics.arccos(np.array([1.0 + 1e-30j]))).all()
    assert np.isfinite(numerics.sqrt(np.array([0.0 + 1e-30j]))).all()


def test_distinct_keeps_what_differs() -> None:
    same, other = np.ones((3, 2, 4)), np.arange(24.0).reshape(3, 2, 4)
    assert numerics.distinct(same).shape == (1, 2, 4)
    assert numerics.distinct(other).shape == other.shape
    assert numerics.distinct(np.ones((3, 4))).shape == (3, 4)


def test_a_root_searched_without_perturbations_carries_them() -> None:
    """First root of t^2 - a: sqrt(a), with slope 1 / (2 sqrt(a))."""
    a = np.array([[0.25 + 1e-30j], [0.64 + 1e-30j]])
    found = numerics.first_root(lambda t: t * t - a, np.ones((2, 1)), unperturbed=lambda t: t * t - a.real)
    np.testing.assert_allclose(found.real[:, 0], [0.5, 0.8], rtol=1e-4)
    np.testing.assert_allclose(found.imag[:, 0] / 1e-30, [1.0, 0.625], rtol=1e-3)


@pytest.mark.parametrize("size", [1, 2, 3, 40, 101])
def test_the_median_is_that_of_numpy_to_the_last_bit(size: int) -> None:
    values = np.random.default_rng(size).normal(size=size)
    assert numerics.median(values) == np.median(values)


def test_the_median_of_a_nan_is_a_nan() -> None:
    assert np.isnan(numerics.median(np.array([1.0, np.nan, 3.0])))
