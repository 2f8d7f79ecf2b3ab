"""Noise between the pulses: vibration of the harvesting machine is told from the noise of kernels, which follows the force."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.waveform.noise_by_phase import PhaseNoise, SteadyNoise, band_power, noise_by_phase, steady_noise

INTERVAL_S, PATTERN_S, BAND_HZ = 1e-3, 0.164, (200.0, 400.0)
IMPULSE_N_S, FORCE_N, QUIET_N = 4e-3, 70.0, 1.3
SECONDS = 40


def steady(vibration: float, *, broad: float = 0.15, frequency_hz: float = 0.0, seed: int = 3) -> SteadyNoise:
    """Of pulses of Poisson kernels, twice a pattern, over vibration of so many times the kernels' mean power.

    broad: standard deviation of a pulse in turns of the pattern. frequency_hz: of vibration that is one line; 0: white.
    """
    rng = np.random.default_rng(seed)
    phase = np.arange(SECONDS * 1000) * INTERVAL_S / PATTERN_S
    shape = sum(np.exp(-0.5 * ((phase - middle + 0.5) % 1.0 - 0.5) ** 2 / broad**2) for middle in (0.25, 0.7))
    force = FORCE_N * shape / shape.mean()
    kernels = IMPULSE_N_S / INTERVAL_S * (rng.poisson(force * INTERVAL_S / IMPULSE_N_S) - force * INTERVAL_S / IMPULSE_N_S)
    size = np.sqrt(vibration * FORCE_N * IMPULSE_N_S / INTERVAL_S)
    time = np.arange(phase.size) * INTERVAL_S
    white = rng.standard_normal(phase.size)
    # A line's power is all in the band, of white noise a fifth of what the band's weights pass.
    line = np.sqrt(2.0 * 0.2) * np.sin(2.0 * np.pi * frequency_hz * time)
    left = kernels + size * (line if frequency_hz else white) + QUIET_N * rng.standard_normal(phase.size)
    low_hz, high_hz = BAND_HZ
    seconds = [slice(first, first + 1000) for first in range(0, phase.size, 1000)]
    parts = [
        noise_by_phase(left[s], force[s] + kernels[s], phase[s], interval_s=INTERVAL_S, low_hz=low_hz, high_hz=high_hz)
        for s in seconds
    ]
    frequency = np.fft.rfftfreq(256, INTERVAL_S)[1:-1]
    quiet = band_power(frequency, np.full(frequency.size, QUIET_N**2 * INTERVAL_S), low_hz, high_hz)
    return steady_noise(
        parts, [1.0] * len(parts), quiet_n2=quiet, pattern_s=PATTERN_S, interval_s=INTERVAL_S, low_hz=low_hz, high_hz=high_hz
    )


@pytest.mark.parametrize("broad", [0.04, 0.07])
@pytest.mark.parametrize("vibration", [0.0, 0.1, 0.5, 2.0])
def test_vibration_is_found_with_its_share(vibration: float, broad: float) -> None:
    assert steady(vibration, broad=broad).share == pytest.approx(vibration / (1.0 + vibration), abs=0.03)


@pytest.mark.parametrize("frequency_hz", [260.0, 330.0])
def test_a_line_of_vibration_is_found(frequency_hz: float) -> None:
    assert steady(0.5, broad=0.05, frequency_hz=frequency_hz).share > 0.2


def test_where_pulses_leave_no_valley_nothing_is_said() -> None:
    assert steady(0.5, broad=0.15) == SteadyNoise(0.0, float("inf"))


def test_noise_below_that_of_the_empty_machine_says_nothing() -> None:
    part = PhaseNoise(np.full(64, 1.0), np.linspace(0.0, 9.0, 64), np.full(64, 10.0))
    found = steady_noise([part], [1.0], quiet_n2=5.0, pattern_s=0.16, interval_s=1e-3, low_hz=200.0, high_hz=400.0)
    assert found.share == 0.0


def test_an_empty_band_has_no_power() -> None:
    """Of samples at 500 Hz, which show up to 200 Hz what is there."""
    white = np.random.default_rng(2).standard_normal(500)
    part = noise_by_phase(white, white, np.arange(500) * 0.012, interval_s=2e-3, low_hz=200.0, high_hz=200.0)
    assert not part.power_n2.any()


def test_power_in_the_band_is_that_of_white_noise_through_its_weights() -> None:
    """Half of 2 (400 - 200) Hz times the density; and the same as the mean square of the samples in the band."""
    frequency = np.fft.rfftfreq(256, 1e-3)[1:-1]
    expected = band_power(frequency, np.full(frequency.size, 1e-3), *BAND_HZ)
    assert expected == pytest.approx(0.2, rel=0.01)
    white = np.random.default_rng(1).standard_normal(60_000)
    part = noise_by_phase(white, white, np.arange(white.size) * 0.006, interval_s=1e-3, low_hz=200.0, high_hz=400.0)
    assert part.power_n2.sum() / part.samples.sum() == pytest.approx(expected, rel=0.03)
