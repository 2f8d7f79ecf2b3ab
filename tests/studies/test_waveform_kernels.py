"""Kernel noise of heaps that are kept from their first strike on: the law of shot noise, whose ratio is one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from studies.waveform import kernels
from yieldmon.estimation.waveform.kernel_noise import KernelImpulse, KernelNoiseSettings, KernelVerdict

SETTINGS = KernelNoiseSettings(low_hz=200.0, high_hz=800.0, response_error=0.0)
KERNEL_G, PUSH_N_S_PER_KG = 0.5, 4.0


def _heaps(folder: Path, load_kg: float, count: int, rng: np.random.Generator) -> Path:
    """Kernels that strike by themselves: a pulse of some 20 ms, and one in fifty anywhere in the 10 ms before it."""
    bins, first_s = 700, 0.09
    number = round(load_kg / (1e-3 * KERNEL_G))
    forces, begins = [], []
    for _ in range(count):
        strike_s = first_s + rng.gamma(4.0, 0.003, number)
        early = rng.random(number) < 0.02
        strike_s[early] = first_s - 0.01 * rng.random(early.sum())
        begin_s = (np.floor(strike_s.min() / kernels.INTERVAL_S) - 1.0) * kernels.INTERVAL_S
        struck = np.histogram(strike_s, begin_s + kernels.INTERVAL_S * np.arange(bins + 1))[0]
        forces.append(struck * (1e-3 * KERNEL_G * PUSH_N_S_PER_KG / kernels.INTERVAL_S))
        begins.append(begin_s)
    file = folder / f"{load_kg}.npz"
    same = {"kernel_g": KERNEL_G, "load_kg": load_kg, "restitution": 0.75, "angle_deg": 70.0}
    columns = {name: np.full(count, value, dtype=np.float32) for name, value in same.items()}
    columns |= {"seed": np.arange(count, dtype=np.float32), "begin_s": np.array(begins, dtype=np.float32)}
    np.savez(file, interval_s=kernels.INTERVAL_S, force_n=np.array(forces, dtype=np.float16), **columns)  # type: ignore[arg-type]
    return file


def test_shot_noise_has_the_kernel_s_own_impulse_whenever_its_first_kernel_strikes(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    pulses = kernels.heaps(_heaps(tmp_path, 0.2, 300, rng), _heaps(tmp_path, 0.5, 300, rng))
    found = kernels.pooled(kernels.ratios(pulses, 0.0, 5000.0, SETTINGS, None), (0, 1))
    assert [ratio for ratio, _ in found.values()] == pytest.approx([1.0, 1.0], rel=0.05)


def test_stated_chance_is_that_of_the_heaps(tmp_path: Path) -> None:
    """60 sets of 12 heaps: their scatter, what each states, and what leaving out one seed after another says."""
    rng = np.random.default_rng(2)
    pulses = kernels.heaps(_heaps(tmp_path, 0.2, 720, rng))
    sets = [pulses.take(pulses.seed // 12 == n) for n in range(60)]
    found = [next(iter(kernels.pooled(kernels.ratios(s, 0.0, 5000.0, SETTINGS, None), (0, 1)).values())) for s in sets]
    by_seeds = [next(iter(kernels.by_seeds_left_out(s, SETTINGS).values())) for s in sets]
    scatter = float(np.std([ratio for ratio, _ in found], ddof=1))
    assert np.mean([sd for _, sd in found]) == pytest.approx(scatter, rel=0.3)
    assert np.mean(by_seeds) == pytest.approx(scatter, rel=0.3)


def test_a_mean_of_cells_does_not_lean_to_those_that_came_out_low() -> None:
    rng = np.random.default_rng(3)
    drawn = 1.0 + 0.2 * rng.standard_normal(4000)
    cells = {
        (0.4, 0.2, float(n), 70.0): (float(r), KernelImpulse(float(r), 0.2, 0.0, KernelVerdict.USED, ""))
        for n, r in enumerate(drawn)
    }
    assert kernels.pooled(cells, (0, 1))[(0.4, 0.2)][0] == pytest.approx(1.0, abs=0.01)


def test_flow_by_the_other_crop_s_line_and_its_deviation() -> None:
    loads = (0.2, 0.5, 0.9)
    by_load = {(crop, load): (1.0 - 0.1 * np.log(load) + off, 0.0) for crop, off in ((0.4, 0.0), (0.8, 0.1)) for load in loads}
    rows = kernels.crossed(by_load, dict.fromkeys(by_load, 0.02))
    line = {(row["kernel_g"], row["load_kg"]): row for row in rows}
    assert line[0.4, 0.5]["flow_error_pct"] == pytest.approx(100.0 * 0.1 / by_load[0.4, 0.5][0], abs=0.05)
    assert line[0.8, 0.9]["flow_error_pct"] == pytest.approx(-100.0 * 0.1 / by_load[0.8, 0.9][0], abs=0.05)
    # A line in ln(load) leans on its own end: shares 0.90, 0.26 and -0.16 of the three at 0.2 kg.
    own, other = by_load[0.4, 0.2][0], by_load[0.8, 0.2][0]
    share = np.hypot(0.9, np.hypot(0.2556, 0.1556))
    whole = np.hypot(0.02 / own, 0.02 * share / other) * other / own
    assert line[0.4, 0.2]["sd_pct"] == pytest.approx(100.0 * whole, abs=0.06)


def _row(ledger: Path, seed: int, angle_deg: float) -> None:
    """A row of a campaign's ledger: a push of 1 ms from 0.1 s on."""
    throw = f"throw{seed}"
    for folder in (ledger / "rows", ledger / "throws" / throw):
        folder.mkdir(parents=True, exist_ok=True)
    row = {"throw_key": throw, "plate_angle_deg": angle_deg, "paddle_mass_kg": 0.2, "restitution": 0.75, "trial": seed}
    (ledger / "rows" / f"{seed}-{angle_deg:g}.json").write_text(json.dumps(row))
    force = np.zeros((400, 2))
    force[100:200, 0] = 10.0
    np.savez(
        ledger / "throws" / throw / f"plate-{angle_deg:07.3f}.npz",
        time_step_s=1e-5, start_s=0.099, total_force_n=force, mass_kg=np.full(4, 4e-4), grain_impulse_n_s=np.full((4, 2), 0.0025),
    )  # fmt: skip


def test_packing_leaves_seeds_out_that_a_campaign_had_not_finished(tmp_path: Path) -> None:
    for seed, angle_deg in ((1, 50.0), (1, 70.0), (2, 50.0)):
        _row(tmp_path / "ledger", seed, angle_deg)
    every, whole = tmp_path / "every.npz", tmp_path / "whole.npz"
    assert (kernels.pack([tmp_path / "ledger"], every), kernels.pack([tmp_path / "ledger"], whole, rows_a_seed=2)) == (3, 2)
    pulses = kernels.heaps(whole)
    assert (pulses.seed.tolist(), pulses.keys[:, 3].tolist()) == ([1, 1], [50.0, 70.0])
    assert pulses.force_n.sum(axis=1) * kernels.INTERVAL_S == pytest.approx([0.01, 0.01], rel=0.01)
