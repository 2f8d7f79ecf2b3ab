"""Deviation of a mean of channels that may lie apart, or lose grain alike."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.waveform.channel_combination import together_sd


@pytest.mark.parametrize(("z", "factor"), [(0.0, 1.0), (0.9, 1.0), (-0.9, 1.0), (1.8, 1.8), (-2.5, 2.5)])
def test_a_difference_beyond_its_deviation_counts_as_a_factor(z: float, factor: float) -> None:
    assert together_sd(0.04, z=z, hit=0.0, hit_sd=0.05) == pytest.approx(0.04 * factor)


def test_what_channels_lose_alike_does_not_average_out() -> None:
    """However sure each of them is; the pulses' shape does not feel it."""
    assert together_sd(0.0, z=0.0, hit=1.0, hit_sd=0.05) == pytest.approx(0.05)
    assert together_sd(0.03, z=0.0, hit=0.5, hit_sd=0.08) == pytest.approx(np.hypot(0.03, 0.04))


@pytest.mark.parametrize(("first_sd", "second_sd"), [(0.08, 0.05), (0.05, 0.15)])
@pytest.mark.parametrize("too_small", [1.0, 2.0])
def test_where_one_states_half_of_its_deviation_fewer_means_go_uncovered(
    first_sd: float, second_sd: float, too_small: float
) -> None:
    """Drawn errors. Two deviations hold 95 % where all is as stated, for at most a quarter more."""
    rng = np.random.default_rng(7)
    first, second = first_sd * rng.standard_normal(4000), too_small * second_sd * rng.standard_normal(4000)
    both = float(np.hypot(first_sd, second_sd))
    weight, plain = (first_sd / both) ** 2, first_sd * second_sd / both
    mean = (1.0 - weight) * first + weight * second
    stated = np.array([together_sd(plain, z=float(apart) / both, hit=0.0, hit_sd=0.05) for apart in second - first])
    missed, missed_before = (float(np.mean(np.abs(mean) > 2.0 * sd)) for sd in (stated, plain))
    if too_small == 1.0:
        assert missed < 0.05
        assert stated.mean() < 1.25 * plain
    else:
        assert missed < 0.6 * missed_before
