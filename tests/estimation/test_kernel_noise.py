"""Kernel noise: Poisson impulses of known size are found again, and a cell too slow is named as such."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.waveform.kernel_noise import (
    KernelImpulse,
    KernelNoiseSettings,
    KernelVerdict,
    kernel_flow,
    kernel_impulse,
)
from yieldmon.estimation.waveform.spectral_density import densities, density, in_pulses

FORCE_N, IMPULSE_N_S, KERNEL_KG = 73.0, 3.6e-3, 4.0e-4
FINE = 20


def felt(
    duration_s: float,
    cell_s: float,
    interval_s: float,
    seed: int,
    noise_n: float = 1.3,
    crest: float = 1.0,
    *,
    averaged: bool = True,
) -> np.ndarray:
    """Samples of a Poisson stream of kernels through a cell whose response is convolved on a fine grid.

    crest: kernels come for so small a part of each 72 ms, the mean force, which is not taken off here, apart. averaged: samples
    are means over their interval.
    """
    rng = np.random.default_rng(seed)
    step = interval_s / FINE
    count = round(duration_s / step)
    open_ = (np.arange(count) * step / 0.072) % 1.0 < 1.0 / crest
    expected = crest * open_ * FORCE_N / IMPULSE_N_S * step
    force = (rng.poisson(expected) - (expected - expected.mean())) * IMPULSE_N_S / step
    if cell_s > 0.0:
        frequency = np.fft.rfftfreq(count, step)
        force = np.fft.irfft(np.fft.rfft(force) / (1.0 + 2j * np.pi * frequency * cell_s) ** 2, count)
    fine = force.reshape(-1, FINE)
    return (fine.mean(axis=1) if averaged else fine[:, -1]) + noise_n * rng.standard_normal(count // FINE)


def quiet(count: int, seed: int, noise_n: float = 1.3) -> np.ndarray:
    return noise_n * np.random.default_rng(seed).standard_normal(count)


@pytest.mark.parametrize(("cell_s", "rate_hz"), [(0.0, 1000.0), (0.0002, 1000.0), (0.001, 1000.0), (0.001, 5000.0)])
def test_finds_the_impulse_of_a_kernel_within_its_deviation(cell_s: float, rate_hz: float) -> None:
    interval = 1.0 / rate_hz
    samples = felt(20.0, cell_s, interval, 11)
    found = kernel_impulse(
        density(samples, interval),
        density(quiet(samples.size, 12), interval),
        FORCE_N,
        cell_response_s=cell_s,
        sample_interval_s=interval,
        settings=KernelNoiseSettings(response_error=0.0),
    )
    assert found.usable
    assert found.impulse_n_s == pytest.approx(IMPULSE_N_S, rel=4.0 * found.relative_sd)
    assert found.random_sd < 0.03


@pytest.mark.parametrize(("cell_s", "rate_hz"), [(0.0002, 1000.0), (0.001, 1000.0), (0.0005, 2000.0)])
def test_samples_of_an_instant_hold_the_aliases_of_all_that_the_cell_lets_through(cell_s: float, rate_hz: float) -> None:
    interval = 1.0 / rate_hz
    samples = felt(20.0, cell_s, interval, 41, averaged=False)
    as_they_are, as_means = (
        kernel_impulse(
            density(samples, interval),
            density(quiet(samples.size, 42), interval),
            FORCE_N,
            cell_response_s=cell_s,
            sample_interval_s=interval,
            settings=KernelNoiseSettings(response_error=0.0, averaged=averaged),
        )
        for averaged in (False, True)
    )
    assert as_they_are.usable
    assert as_they_are.impulse_n_s == pytest.approx(IMPULSE_N_S, rel=3.0 * as_they_are.relative_sd)
    assert as_they_are.relative_sd < 0.05
    assert as_means.impulse_n_s > 1.1 * IMPULSE_N_S


def test_samples_of_an_instant_without_a_cell_say_nothing() -> None:
    """Of the aliases a contact keeps back an unknown share."""
    samples = quiet(20000, 43)
    found = kernel_impulse(
        density(2.0 * samples, 1e-3),
        density(samples, 1e-3),
        FORCE_N,
        cell_response_s=0.0,
        sample_interval_s=1e-3,
        settings=KernelNoiseSettings(averaged=False),
    )
    assert found.verdict is KernelVerdict.NO_BAND
    assert "aliases" in found.reason


@pytest.mark.parametrize("line_hz", [250.0, 350.0])
def test_a_line_that_only_harvesting_has_is_covered_or_refused(line_hz: float) -> None:
    for line_n in (0.0, 3.0, 10.0):
        samples = felt(20.0, 0.0002, 1e-3, 31)
        samples = samples + line_n * np.sin(2.0 * np.pi * line_hz * 1e-3 * np.arange(samples.size))
        found = kernel_impulse(
            density(samples, 1e-3),
            density(quiet(samples.size, 32), 1e-3),
            FORCE_N,
            cell_response_s=0.0002,
            sample_interval_s=1e-3,
        )
        assert found.usable is (line_n < 10.0)
        assert ("not even over the band" in found.reason) is (line_n == 10.0)
        if found.usable:
            assert found.impulse_n_s == pytest.approx(IMPULSE_N_S, rel=2.0 * found.relative_sd)


@pytest.mark.parametrize("stated_s", [1e-4, 2e-4, 8e-4])
def test_a_cell_far_from_what_is_stated_is_covered_or_refused(stated_s: float) -> None:
    """Of 0.4 ms: with a quarter of it stated the impulse comes out half as large."""
    samples = felt(60.0, 4e-4, 1e-3, 41)
    found = kernel_impulse(
        density(samples, 1e-3),
        density(quiet(samples.size, 42), 1e-3),
        FORCE_N,
        cell_response_s=stated_s,
        sample_interval_s=1e-3,
    )
    assert not found.usable
    assert found.verdict is KernelVerdict.UNEVEN
    assert "response_s" in found.reason


def test_what_stays_between_the_pulses_is_taken_off_and_half_of_it_doubted() -> None:
    samples = felt(60.0, 2e-4, 1e-3, 43)
    given = density(samples, 1e-3), density(quiet(samples.size, 44), 1e-3), FORCE_N
    plain, less, much = (
        kernel_impulse(*given, cell_response_s=2e-4, sample_interval_s=1e-3, steady_share=share) for share in (0.0, 0.2, 0.6)
    )
    assert less.impulse_n_s == pytest.approx(0.8 * plain.impulse_n_s, rel=0.02)
    assert less.usable
    assert less.lasting_sd == pytest.approx(0.125, abs=0.03)
    assert much.verdict is KernelVerdict.BACKGROUND


@pytest.mark.parametrize("crest", [1.0, 4.0])
def test_random_deviation_is_the_scatter_over_seeds(crest: float) -> None:
    """Kernels strike evenly, or for a quarter of the time."""
    values, stated = [], []
    still = density(quiet(20000, 500), 1e-3)
    for seed in range(120):
        samples = felt(2.0, 0.0002, 1e-3, 100 + seed, crest=crest)
        found = kernel_impulse(
            in_pulses(density(samples, 1e-3), crest), still, FORCE_N, cell_response_s=0.0002, sample_interval_s=1e-3
        )
        values.append(found.impulse_n_s)
        stated.append(found.random_sd)
    assert np.std(values) / np.mean(values) == pytest.approx(np.mean(stated), rel=0.2)


def test_says_by_itself_that_a_cell_is_too_slow() -> None:
    samples = felt(20.0, 0.008, 1e-3, 5)
    found = kernel_impulse(
        density(samples, 1e-3), density(quiet(samples.size, 6), 1e-3), FORCE_N, cell_response_s=0.008, sample_interval_s=1e-3
    )
    assert not found.usable
    assert found.reason


@pytest.mark.parametrize(
    ("force_n", "low_hz", "reason"), [(0.0, 200.0, "no force of grain"), (50.0, 600.0, "no frequency of the samples")]
)
def test_names_what_is_missing(force_n: float, low_hz: float, reason: str) -> None:
    still = density(quiet(4000, 1), 1e-3)
    found = kernel_impulse(
        still, still, force_n, cell_response_s=0.0, sample_interval_s=1e-3, settings=KernelNoiseSettings(low_hz=low_hz)
    )
    assert not found.usable
    assert reason in found.reason


def test_flow_follows_the_kernel_s_mass_and_not_the_scale_of_force() -> None:
    settings = KernelNoiseSettings(bias=1.0, bias_sd=0.05)
    found = KernelImpulse(IMPULSE_N_S, 0.02, 0.01, KernelVerdict.USED, "")
    twice = KernelImpulse(2.0 * IMPULSE_N_S, 0.02, 0.01, KernelVerdict.USED, "")
    flow = kernel_flow(found, FORCE_N, KERNEL_KG, kernel_mass_sd=0.03, settings=settings)
    assert flow.mass_flow_kg_s == pytest.approx(FORCE_N * KERNEL_KG / IMPULSE_N_S)
    assert flow.relative_sd == pytest.approx(np.sqrt(0.02**2 + 0.01**2 + 0.05**2 + 0.03**2))
    assert kernel_flow(twice, 2.0 * FORCE_N, KERNEL_KG, settings=settings).mass_flow_kg_s == pytest.approx(flow.mass_flow_kg_s)


def test_density_of_white_noise_is_its_variance_times_the_interval() -> None:
    found = density(quiet(200_000, 3, 2.0), 1e-3)
    assert found.density.mean() == pytest.approx(4.0e-3, rel=0.02)
    with pytest.raises(ValueError, match="at least one segment of 256"):
        density(quiet(100, 3), 1e-3)


def test_stretches_side_by_side_have_the_densities_that_each_has_alone() -> None:
    rng = np.random.default_rng(12)
    stretches = [rng.standard_normal(length) for length in (1003, 256, 640, 997, 383)]
    for stretch, found in zip(stretches, densities(stretches, 1e-3), strict=True):
        alone = density(stretch, 1e-3)
        assert found.density.tobytes() == alone.density.tobytes()
        assert found.averages == alone.averages
    assert densities([], 1e-3) == []
    with pytest.raises(ValueError, match="255 samples, expected at least one segment of 256"):
        densities([stretches[0], stretches[0][:255]], 1e-3)
