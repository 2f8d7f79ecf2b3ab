"""A pattern that sweeps share is found; what they do not share is not."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.misfit import SweepResiduals, common_misfit

ANGLES = np.radians([40.0, 45.0, 50.0, 55.0, 60.0, 65.0, 70.0, 75.0, 80.0, 85.0, 90.0])
SD = np.full(ANGLES.shape, 0.01)


def sweeps(pattern: np.ndarray, count: int, seed: int, scatter: float = 0.01) -> list[SweepResiduals]:
    rng = np.random.default_rng(seed)
    return [SweepResiduals(ANGLES, pattern + scatter * rng.standard_normal(ANGLES.size), SD, 3) for _ in range(count)]


LOCAL = np.where((np.radians(54.0) < ANGLES) & (np.radians(66.0) > ANGLES), -0.03, 0.0)


def test_a_shared_pattern_is_found_with_its_region_and_sign() -> None:
    found = common_misfit(sweeps(LOCAL, 6, seed=1))
    assert found.disagrees
    assert np.degrees(found.plate_angle_rad) == pytest.approx([55.0, 65.0])
    assert found.mean_relative_error == pytest.approx(-0.03, abs=0.01)


def test_noise_raises_no_alarm() -> None:
    assert not any(common_misfit(sweeps(0.0 * ANGLES, 6, seed)).disagrees for seed in range(200))


def test_a_pattern_of_one_sweep_alone_raises_no_alarm() -> None:
    """Flow that wandered in each sweep in its own way."""
    wander = [sweeps(0.08 * np.sin(4.0 * ANGLES + phase), 1, seed)[0] for seed, phase in enumerate(np.linspace(0.0, 5.0, 6))]
    assert not common_misfit(wander).disagrees


def test_noise_above_what_was_stated_raises_no_alarm() -> None:
    assert not any(common_misfit(sweeps(0.0 * ANGLES, 6, seed, scatter=0.05)).disagrees for seed in range(100))


@pytest.mark.parametrize("count", [0, 1, 3])
def test_few_sweeps_say_nothing(count: int) -> None:
    found = common_misfit(sweeps(LOCAL, count, seed=1))
    assert (found.disagrees, found.p_value) == (False, 1.0)


def test_unknown_residuals_are_passed_over() -> None:
    broken = [
        SweepResiduals(s.plate_angle_rad, np.where(ANGLES > 1.5, np.nan, s.relative_residual), s.sd, 3)
        for s in sweeps(LOCAL, 6, 1)
    ]
    assert common_misfit(broken).disagrees
