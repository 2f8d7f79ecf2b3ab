"""Kernels in the virtual combine: the same mean force, with the shot noise that their weight means."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.waveform.kernel_noise import kernel_impulse
from yieldmon.estimation.waveform.spectral_density import density
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant.combine import VirtualCombine, pulse_table
from yieldmon.plant.kernels import strike
from yieldmon.plant.pulse_table import QUANTILES
from yieldmon.plant.scenario import Kernels, Scenario, from_mapping

STEADY = {
    "duration_s": 14,
    "flow": {"pieces": [{"kind": "steady", "duration_s": 14, "flow_kg_s": 8.0}]},
    "sensor": {
        "noise_mv": 0.0,
        "vibration_sprocket_n": 0.0,
        "vibration_paddle_n": 0.0,
        "response_s": 0.0002,
        "drift_mv_per_sqrt_h": 0,
    },
    "paddle_scatter_pct": 0.0,
}


@pytest.mark.parametrize(("weight_g", "ratio"), [(350.0, 1.0), (40.0, 1.0), (350.0, 0.6)])
def test_variance_over_mean_is_the_kernel_s_impulse(weight_g: float, ratio: float) -> None:
    rng = np.random.default_rng(1)
    settings = Kernels(thousand_kernel_weight_g=weight_g, mass_spread_pct=0.0, noise_ratio=ratio)
    times = 0.01 + 0.02 * QUANTILES
    struck = np.stack([strike(settings, 0.5, 4.0, times, 1e-3, 40, rng) for _ in range(400)])
    inside = struck[:, 12:28]
    assert inside.var(axis=0).mean() / inside.mean() == pytest.approx(ratio * weight_g * 1e-6 * 4.0 / 0.5, rel=0.08)
    assert struck.sum(axis=1).mean() == pytest.approx(4.0, rel=0.01)
    assert struck[:, :9].sum() == 0.0


def test_kernels_keep_the_mean_force_and_add_noise() -> None:
    smooth = from_mapping(STEADY, "test")
    table = pulse_table(smooth, Machine())
    fine, grainy = (from_mapping({**STEADY, "kernels": {"thousand_kernel_weight_g": w}}, "test") for w in (10, 350))
    plain, flour, kernels = (
        VirtualCombine(s, seed=3, table=table).samples_until(14.0).sample_mv[4000:] for s in (smooth, fine, grainy)
    )
    assert kernels.mean() == pytest.approx(plain.mean(), rel=0.01)
    # Speeds, loads and arrival times are the same: the difference is the kernels' alone.
    shown, nothing = density(0.4448 * (kernels - flour), 1e-3), density(np.zeros(5000), 1e-3)
    force_n = 0.4448 * (plain.mean() - 500.0)
    found = kernel_impulse(shown, nothing, force_n, cell_response_s=0.0002, sample_interval_s=1e-3)
    # Impulse per kilogram times a kernel's mass; the spread of kernels adds its square, those of 10 g their own noise.
    assert found.impulse_n_s == pytest.approx(force_n / 8.0 * 3.6e-4 * (1.0 + 0.12**2), rel=0.06)


@pytest.mark.parametrize("mass_kg", [0.5, 0.9])
def test_the_stream_has_no_edges_of_its_own_where_kernels_are_listened_to(mass_kg: float) -> None:
    """Pulses of discrete elements at 300 to 450 Hz have at most 2 % of their impulse (studies/waveform/kernel_forces.npz)."""
    scenario = from_mapping({**STEADY, "kernels": {}}, "test")
    times = pulse_table(scenario, Machine()).arrival_times_s(mass_kg, np.deg2rad(70.0), 400.0 * RPM)
    shares, middles, widths = np.diff(QUANTILES), 0.5 * (times[1:] + times[:-1]), np.diff(times)
    frequency = np.arange(300.0, 451.0, 10.0)[:, None]
    spectrum = np.abs((shares * np.exp(-2j * np.pi * frequency * middles) * np.sinc(frequency * widths)).sum(axis=1))
    assert np.sqrt(np.mean(spectrum**2)) < 0.035


def test_a_contact_spreads_a_kernel_s_push_and_keeps_its_impulse() -> None:
    times = np.full(QUANTILES.size, 0.01)
    settings = Kernels(thousand_kernel_weight_g=350.0, contact_ms=0.5)
    struck = strike(settings, 0.5, 4.0, times, 5e-5, 400, np.random.default_rng(2))
    at_once = strike(
        Kernels(thousand_kernel_weight_g=350.0, contact_ms=0.0), 0.5, 4.0, times, 5e-5, 400, np.random.default_rng(2)
    )
    assert struck.sum() == pytest.approx(at_once.sum())
    assert np.count_nonzero(at_once) == 1
    assert np.count_nonzero(struck) == 10
    late = strike(settings, 0.5, 4.0, times + 0.02, 5e-5, 400, np.random.default_rng(2))
    assert late.sum() == pytest.approx(at_once.sum())


def test_noise_goes_with_the_load_as_asked_for() -> None:
    times = 0.01 + 0.02 * QUANTILES
    settings = Kernels(mass_spread_pct=0.0, noise_load_exponent=-0.5)
    rng = np.random.default_rng(4)
    ratios = []
    for mass in (0.5, 2.0):
        struck = np.stack([strike(settings, mass, 4.0, times, 1e-3, 40, rng) for _ in range(400)])[:, 12:28]
        ratios.append(struck.var(axis=0).mean() / struck.mean() / (3.5e-4 * 4.0 / mass))
    assert ratios == pytest.approx([1.0, 0.5], rel=0.08)


def test_kernels_are_off_unless_asked_for() -> None:
    assert Scenario().kernels is None
