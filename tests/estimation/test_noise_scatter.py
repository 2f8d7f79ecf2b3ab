"""Noise that differs from second to second beyond chance, as of one paddle of the chain, counts as a deviation."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.waveform.kernel_noise import kernel_impulse
from yieldmon.estimation.waveform.noise_scatter import excess_scatter
from yieldmon.estimation.waveform.spectral_density import Density, density, pooled

INTERVAL_S, KERNELS_N, QUIET_N = 1e-3, 3.0, 1.0
BAND = {"low_hz": 200.0, "high_hz": 400.0}


def heard(more: float, *, every: int = 3, count: int = 60, seed: int = 4) -> tuple[list[Density], list[float], Density]:
    """Windows of a second, of sizes that differ, every so many with so much more power; their sizes; the empty machine."""
    rng = np.random.default_rng(seed)
    sizes = np.exp(0.2 * rng.standard_normal(count))
    powers = QUIET_N**2 + KERNELS_N**2 * sizes * (1.0 + more * (np.arange(count) % every == 0))
    windows = [density(np.sqrt(power) * rng.standard_normal(1000), INTERVAL_S) for power in powers]
    empty = pooled([density(QUIET_N * rng.standard_normal(1000), INTERVAL_S) for _ in range(20)])
    return windows, sizes.tolist(), empty


@pytest.mark.parametrize("seed", range(8))
def test_chance_alone_counts_for_little(seed: int) -> None:
    windows, sizes, empty = heard(0.0, seed=seed)
    assert excess_scatter(windows, empty, sizes, **BAND) < 0.05


@pytest.mark.parametrize(("more", "every"), [(0.4, 3), (1.0, 3), (1.0, 2), (3.0, 10)])
def test_what_some_windows_have_more_is_covered(more: float, every: int) -> None:
    """The mean is too high by more / every."""
    windows, sizes, empty = heard(more, every=every)
    relative_error = (more / every) / (1.0 + more / every)
    assert relative_error / 2.0 < excess_scatter(windows, empty, sizes, **BAND) < 2.0 * np.sqrt(every) * relative_error


@pytest.mark.parametrize("what", ["few windows", "no band", "no noise above the empty machine's"])
def test_nothing_is_said_where_nothing_can_be(what: str) -> None:
    windows, sizes, empty = heard(1.0, count=9 if what == "few windows" else 20)
    if what.startswith("no noise"):
        windows = [Density(w.frequency_hz, 0.5 * empty.density, w.averages) for w in windows]
    band = BAND | ({"low_hz": 600.0, "high_hz": 800.0} if what == "no band" else {})
    assert excess_scatter(windows, empty, sizes, **band) == 0.0


def test_it_is_part_of_the_impulse_s_deviation_and_may_forbid_it() -> None:
    windows, sizes, empty = heard(0.0)
    given = {"cell_response_s": 0.0, "sample_interval_s": INTERVAL_S}
    plain, doubted, refused = (
        kernel_impulse(pooled(windows), empty, 70.0 * float(np.mean(sizes)), scatter=scatter, **given)
        for scatter in (0.0, 0.1, 0.3)
    )
    assert plain.usable
    assert doubted.impulse_n_s == plain.impulse_n_s
    assert doubted.relative_sd == pytest.approx(np.hypot(plain.relative_sd, 0.1))
    assert not refused.usable
    assert "over time" in refused.reason
