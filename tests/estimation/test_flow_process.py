"""The size of a flow's wandering from visits to like angles."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.self_calibration.flow_process import process_sd

ANGLES = np.radians(np.repeat([70, 40, 40, 70, 50, 60, 70, 80, 90, 70, 90, 90, 70], 2).astype(float))
TIME_S = np.arange(ANGLES.size) * 1.5
TIME_CONSTANT_S = 30.0
NOISE = 0.024


def wandering(size: float, rng: np.random.Generator) -> np.ndarray:
    """A step-by-step random walk with recall, not the covariance that the estimator uses."""
    out = [size * rng.normal()]
    for gap in np.diff(TIME_S):
        keep = np.exp(-gap / TIME_CONSTANT_S)
        out.append(keep * out[-1] + size * np.sqrt(1.0 - keep**2) * rng.normal())
    return np.array(out)


def estimate(log_flow: np.ndarray, prior_sd: float = 0.06) -> float:
    return process_sd(log_flow, np.full(ANGLES.size, NOISE), ANGLES, TIME_S, TIME_CONSTANT_S, prior_sd)


@pytest.mark.parametrize("size", [0.03, 0.08, 0.2, 0.4])
def test_the_size_of_the_wandering_is_found(size: float) -> None:
    rng = np.random.default_rng([31, int(1000 * size)])
    found = [estimate(wandering(size, rng) + NOISE * rng.normal(size=ANGLES.size)) for _ in range(60)]
    assert np.median(found) == pytest.approx(size, rel=0.25, abs=0.012)


def test_an_error_that_belongs_to_the_angle_is_no_wandering() -> None:
    rng = np.random.default_rng(32)
    log_flow = wandering(0.05, rng) + NOISE * rng.normal(size=ANGLES.size)
    by_angle = 0.4 * np.cos(3.0 * ANGLES)
    assert estimate(log_flow + by_angle) == pytest.approx(estimate(log_flow), rel=1e-9)


def test_without_a_second_visit_the_prior_stays() -> None:
    once = np.radians([40.0, 55.0, 70.0, 90.0])
    clock = np.arange(4.0)
    assert process_sd(np.array([0.0, 0.5, -0.5, 0.1]), np.full(4, NOISE), once, clock, TIME_CONSTANT_S, 0.06) == 0.06


def test_a_flow_declared_steady_stays_steady() -> None:
    rng = np.random.default_rng(33)
    assert estimate(wandering(0.3, rng), prior_sd=0.0) == 0.0


def test_windows_without_information_leave_the_prior() -> None:
    """A log-normal of one e, cut off at three, has this root mean square; worked out by hand from the normal distribution."""
    found = process_sd(np.zeros(ANGLES.size), np.full(ANGLES.size, 1e4), ANGLES, TIME_S, TIME_CONSTANT_S, 0.06)
    assert found == pytest.approx(0.06 * np.sqrt(np.exp(2.0) * 0.84134 / 0.9973), rel=0.01)
