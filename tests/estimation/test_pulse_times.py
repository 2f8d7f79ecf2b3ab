"""Pulses out of place are told from the chance that kernels give a pulse's time."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.waveform.pulse_times import misplaced_share, pulse_times

BINS, PATTERN_S, IMPULSE_N_S = 512, 0.164, 3.0e-3
LOW_HZ, HIGH_HZ = 200.0, 400.0
TURNS = (np.arange(BINS) + 0.5) / BINS


def mean_pulse() -> np.ndarray:
    """Two pulses a pattern that rise in two milliseconds and fall in ten, N."""
    rise, fall = 0.002 / PATTERN_S, 0.010 / PATTERN_S
    from_peak = (TURNS * 2.0) % 1.0 / 2.0 - 0.1
    return np.asarray(200.0 * np.where(from_peak < 0.0, np.exp(from_peak / rise), np.exp(-from_peak / fall)))


def by_chance(windows: int, seed: int) -> list[np.ndarray]:
    """Turns by which pulses of kernels that strike by chance seem late: least squares on the mean pulse's slope."""
    rng, mean = np.random.default_rng(seed), mean_pulse()
    step_s = PATTERN_S / BINS
    waves = np.fft.rfft(mean)
    waves[np.arange(waves.size) / PATTERN_S > HIGH_HZ] = 0.0
    slope = np.fft.irfft(waves * 2.0j * np.pi * np.arange(waves.size), BINS)
    found = []
    for _ in range(windows):
        kernels = rng.poisson(np.tile(mean * step_s / IMPULSE_N_S, (6, 1)))
        left = (kernels * IMPULSE_N_S / step_s - mean).reshape(-1, BINS // 2)
        slopes = np.tile(slope, 6).reshape(-1, BINS // 2)
        found.append(-(left * slopes).sum(axis=1) / (slopes**2).sum(axis=1))
    return found


def share(late: list[np.ndarray], power_n2: float) -> float:
    shown = [pulse_times(turns, mean_pulse(), pulses=2, pattern_s=PATTERN_S, low_hz=LOW_HZ, high_hz=HIGH_HZ) for turns in late]
    return misplaced_share(shown, IMPULSE_N_S, [power_n2] * len(shown))


def test_what_kernels_make_of_the_times_is_not_held_for_pulses_out_of_place() -> None:
    """Their noise in the band is 2 F J times its width."""
    power = 2.0 * float(mean_pulse().mean()) * IMPULSE_N_S * (HIGH_HZ - LOW_HZ)
    assert share(by_chance(60, 5), power) < 0.05


@pytest.mark.parametrize("late_s", [2e-4, 4e-4])
def test_what_pulses_out_of_place_leave_goes_with_the_square_of_how_far(late_s: float) -> None:
    power = 2.0 * float(mean_pulse().mean()) * IMPULSE_N_S * (HIGH_HZ - LOW_HZ)
    rng = np.random.default_rng(8)
    late = [turns + late_s / PATTERN_S * rng.standard_normal(turns.size) for turns in by_chance(240, 5)]
    shown = pulse_times(late[0], mean_pulse(), pulses=2, pattern_s=PATTERN_S, low_hz=LOW_HZ, high_hz=HIGH_HZ)
    # The mean of pulses out of place is blurred.
    variance_s2 = late_s**2
    steep = float((shown.steepness_n2_s2 * np.exp(variance_s2 * (2.0 * np.pi * shown.frequency_hz) ** 2)).sum())
    assert share(late, power) == pytest.approx(variance_s2 * steep / power, rel=0.2)


def test_few_pulses_and_no_noise_say_nothing() -> None:
    late = [np.array([0.01, -0.01, 0.02])]
    assert share(late, 1.0) == 0.0
    assert share(by_chance(60, 5), 0.0) == 0.0


def test_one_paddle_of_many_counts_but_does_not_blur_the_mean() -> None:
    late, away_s = by_chance(60, 5), 4e-3
    power = 2.0 * float(mean_pulse().mean()) * IMPULSE_N_S * (HIGH_HZ - LOW_HZ)
    for turns in late[::3]:
        turns[4] += away_s / PATTERN_S
    shown = pulse_times(late[0], mean_pulse(), pulses=2, pattern_s=PATTERN_S, low_hz=LOW_HZ, high_hz=HIGH_HZ)
    turned_s = 2.0 * np.pi * shown.frequency_hz
    apart = float((shown.steepness_n2_s2 * (2.0 - 2.0 * np.cos(turned_s * away_s)) / turned_s**2).sum()) / 36.0
    assert share(late, power) == pytest.approx(apart / power, abs=0.02)
