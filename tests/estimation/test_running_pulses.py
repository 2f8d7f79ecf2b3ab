"""Mean pulses by load: what is taken off a window is the mean of windows like it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.one_window import fold, harmonics_of, residual
from yieldmon.estimation.waveform.running_pulses import RunningPulses

HOME = {"plate_angle_rad": 1.2, "elevator_speed_rad_s": 42.0}


def window(number: int, height_n: float, noise_n: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A second of two pulses a turn, wider and higher where more grain comes, and its phase."""
    phase = (1000 * number + np.arange(1000)) * 2.6e-3
    width = 0.04 * (height_n / 50.0) ** 0.5
    shape = np.exp(-0.5 * (((2.0 * phase) % 1.0 - 0.5) / (2.0 * width)) ** 2)
    return height_n * shape + noise_n * np.random.default_rng([seed, number]).standard_normal(1000), phase


def test_windows_of_two_loads_leave_only_their_noise() -> None:
    """One mean for both would leave pulses: twice the noise and more."""
    pulses, left = RunningPulses(), []
    for number in range(80):
        height = (50.0, 100.0)[number // 5 % 2]
        samples, phase = window(number, height, 1.0, 1)
        like = pulses.take(samples, phase, mean_force_n=height / 3.0, **HOME)
        if like is not None and number > 40:
            mean, own = like
            left.append(float(np.var(residual(samples, phase, mean)) / (1.0 + own)))
    assert len(left) > 30
    assert np.mean(left) == pytest.approx(1.0, rel=0.05)


def test_the_chance_of_a_mean_of_few_windows_is_allowed_for() -> None:
    left = []
    for seed in range(30):
        pulses = RunningPulses()
        for number in range(5):
            samples, phase = window(number, 50.0, 1.0, seed)
            like = pulses.take(samples, phase, mean_force_n=17.0, **HOME)
            if like is not None:
                mean, own = like
                assert own > 0.05
                left.append(float(np.var(residual(samples, phase, mean)) / (1.0 + own)))
    assert len(left) >= 30
    assert np.mean(left) == pytest.approx(1.0, rel=0.06)


@pytest.mark.parametrize("changed", [{"mean_force_n": 25.0}, {"plate_angle_rad": 1.3}, {"elevator_speed_rad_s": 46.0}])
def test_pulses_of_another_kind_begin_anew(changed: dict[str, float]) -> None:
    pulses = RunningPulses()
    usual = {"mean_force_n": 17.0, **HOME}
    found = [pulses.take(*window(number, 50.0, 1.0, 2), **usual) for number in range(12)]
    assert found[0] is None
    assert found[-1] is not None
    assert pulses.take(*window(12, 50.0, 1.0, 2), **{**usual, **changed}) is None
    assert pulses.take(*window(13, 50.0, 1.0, 2), **usual) is not None


@pytest.mark.parametrize(("others", "kept"), [(59, True), (60, False), (80, False)])
def test_a_kind_not_met_for_a_minute_of_grain_is_forgotten(others: int, kept: bool) -> None:
    pulses = RunningPulses()
    for number in range(12):
        pulses.take(*window(number, 50.0, 1.0, 3), mean_force_n=17.0, **HOME)
    for number in range(others):
        pulses.take(*window(number, 50.0, 1.0, 3), mean_force_n=20.0 * 1.2 ** (number % 8), **HOME)
    assert (pulses.take(*window(99, 50.0, 1.0, 3), mean_force_n=17.0, **HOME) is not None) is kept


@pytest.mark.parametrize("late_turns", [0.0, 0.004, -0.013, 0.031])
def test_how_late_a_window_comes_is_told_by_its_mean(late_turns: float) -> None:
    """Within a hundredth of a pulse's width; an own time of a few milliseconds is beyond what a straight line takes off."""
    pulses = RunningPulses()
    kind = {"mean_force_n": 17.0, **HOME}

    def asked(phase: np.ndarray, samples: np.ndarray) -> float:
        wave = harmonics_of(fold(samples, phase), 20, elevator_speed_rad_s=42.0, plate_angle_rad=1.2)
        return pulses.late_turns(wave.amplitudes_n, **kind)

    for number in range(12):
        samples, phase = window(number, 50.0, 1.0, 2)
        if number == 0:
            assert asked(phase, samples) == 0.0
        pulses.take(samples, phase, **kind)
    samples, phase = window(12, 50.0, 1.0, 2)
    assert asked(phase + late_turns, samples) == pytest.approx(late_turns, abs=5e-4)


def test_pulses_that_lie_elsewhere_are_left_where_they_are() -> None:
    pulses = RunningPulses()
    for number in range(12):
        pulses.take(*window(number, 50.0, 1.0, 2), mean_force_n=17.0, **HOME)
    samples, phase = window(12, 50.0, 1.0, 2)
    wave = harmonics_of(fold(samples, phase + 0.25), 20, elevator_speed_rad_s=42.0, plate_angle_rad=1.2)
    assert pulses.late_turns(wave.amplitudes_n, mean_force_n=17.0, **HOME) == 0.0
