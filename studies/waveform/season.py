"""Load errors of a season in which restitution and density drift by 15 %, by the channels that weigh the grain.

(b) mean force, its friction followed as sweeps at best follow it; (e) mean force and pulse shape as `waveform.combine` has them;
(f) and kernel noise, by variance; (g) and a ticket after each third of the season. Forces are the virtual combine's parcels, the
estimators those of the daemon. Kernels are not simulated one by one: their flow is the true one, off by chance, by the kernels'
weight and by what discrete elements say (kernels.json) of a bias calibrated at the season's start.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.waveform.arrival import sample_noise_n
from studies.waveform.fill import FOLDER
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.waveform.arrival_law import ArrivalLaw
from yieldmon.estimation.waveform.channel_combination import combine
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.pulse_model import PulseModel, PulseSettings
from yieldmon.estimation.waveform.pulse_shape import estimate
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.effects import Effects
from yieldmon.plant.grain import Grain
from yieldmon.plant.throw import throw

Array = NDArray[np.float64]
LOADS, WINDOWS = 24, 4
"""Of a season; windows that stand for a load's seconds."""
DRIFT = 0.15
SPEED_RAD_S = 400.0 * RPM
HOME_RAD = float(np.deg2rad(70.0))
CELL_S = 0.008
SCATTER = 0.07
PATTERNS = 6.0
NOISE_N = 1.33
FRICTION_SD = 0.03
WEIGHT_SD, WEIGHT_LOADS = 0.02, 8
"""Of the kernels' weight as entered, and for how many loads it is."""
KERNEL_RANDOM_SD = 0.01
TICKETS = (8, 16)
MACHINE = Machine()
START = Grain()


@dataclass(frozen=True)
class Window:
    """True flow, and what the plate shows: mean force and harmonics of the pattern."""

    flow_kg_s: float
    force_n: float
    wave: PatternWave


def _windows(grain: Grain, flows: Array, noise_n: Array, rng: np.random.Generator) -> list[Window]:
    gaps = np.asarray(MACHINE.paddle_spacings_m)
    speed = MACHINE.paddle_speed_m_s(SPEED_RAD_S)
    base = 2.0 * np.pi * speed / MACHINE.pattern_length_m
    omega = base * np.arange(1, noise_n.size + 1)
    masses = np.outer(flows, gaps) / speed
    parcels = throw(MACHINE, grain, Effects(), masses.ravel(), HOME_RAD, SPEED_RAD_S, cells=150)
    impulse, arrival = (np.asarray(a).reshape(masses.size, -1) for a in (parcels.impulse_n_s, parcels.arrival_s))
    found = []
    for n, flow in enumerate(flows):
        scatter = 1.0 + SCATTER / np.sqrt(PATTERNS) * rng.standard_normal(gaps.size)
        wave, total = np.zeros(omega.size, dtype=complex), 0.0
        for i, place in enumerate(np.cumsum(gaps)):
            row = n * gaps.size + i
            struck = impulse[row] > 0.0
            when = arrival[row][struck] + place / speed
            wave += scatter[i] * np.exp(-1j * np.outer(omega, when)) @ impulse[row][struck]
            total += scatter[i] * float(impulse[row][struck].sum())
        wave = wave * base / (2.0 * np.pi) / (1.0 + 1j * omega * CELL_S) ** 2
        wave = wave + noise_n * (rng.standard_normal(omega.size) + 1j * rng.standard_normal(omega.size))
        force = total * base / (2.0 * np.pi) + NOISE_N / np.sqrt(1000.0) * rng.standard_normal()
        found.append(Window(float(flow), float(force), PatternWave(wave, noise_n, PATTERNS, SPEED_RAD_S, HOME_RAD)))
    return found


def _knowledge(progress: float, friction: float) -> tuple[OpenLoop, PulseModel]:
    """What the daemon holds: density and restitution of the season's start, doubted by what may have drifted since."""
    values = {
        "friction": friction, "density": START.bulk_density_kg_m3, "shape_ratio": START.shape_ratio,
        "restitution": START.restitution, "gravity.acceleration_m_s2": 9.81,
    }  # fmt: skip
    names = ("friction", "density", "restitution")
    drift = DRIFT * progress
    relative = np.array([FRICTION_SD, np.hypot(0.02, drift), np.hypot(0.02, drift)])
    covariance = np.diag((relative * [values[n] for n in names]) ** 2)
    model = ForwardModel(MACHINE, ("gravity",))
    law = ArrivalLaw(tail=(float(np.log(0.002)),), covariance=(0.03**2, 1.0, 0.0))
    settings = PulseSettings(model_error=0.1, cell_response_s=CELL_S, arrival=law)
    return OpenLoop(model, ParameterSet(values, names, covariance)), PulseModel(model, values, settings)


def bias_slope() -> float:
    """d ln(b) / d restitution in discrete elements."""
    rows = json.loads((FOLDER / "kernels.json").read_text())["by_restitution"]
    return float(np.polyfit([r["restitution"] for r in rows], np.log([r["ratio"] for r in rows]), 1)[0])


def season(seed: int) -> dict[str, Any]:
    """Errors of the loads, %, by channel."""
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=3)
    slope = bias_slope()
    errors: dict[str, list[float]] = {name: [] for name in "befg"}
    scale = 1.0
    refused = 0
    weight_error = 0.0
    for n in range(LOADS):
        progress = n / (LOADS - 1)
        friction, restitution, density = (
            value * (1.0 + DRIFT * sign * progress)
            for value, sign in zip((START.friction, START.restitution, START.bulk_density_kg_m3), signs, strict=True)
        )
        grain = Grain(friction, restitution, density, START.shape_ratio)
        followed = friction * (1.0 + FRICTION_SD * rng.standard_normal())
        open_loop, pulses = _knowledge(progress, followed)
        noise_n = sample_noise_n(pulses, sample_sd_n=NOISE_N, samples=1000.0)
        windows = _windows(grain, rng.uniform(5.0, 16.0, WINDOWS), noise_n, rng)
        truth = sum(w.flow_kg_s for w in windows)
        b, e, variance = 0.0, 0.0, 0.0
        for window in windows:
            noise = window.force_n * SCATTER / np.sqrt(2.0 * PATTERNS)
            found = open_loop.estimate(window.force_n, HOME_RAD, SPEED_RAD_S, noise)
            rate, sd = float(found.mass_flow_kg_s), float(found.std_dev_kg_s)
            assert found.noise_std_dev_kg_s is not None
            exponent = float(noise / found.noise_std_dev_kg_s * rate / window.force_n)
            shape = estimate(pulses, window.wave)
            refused += not np.isfinite(shape.volume_flow_m3_s)
            flow = shape.volume_flow_m3_s * START.bulk_density_kg_m3
            both = combine(rate, sd / rate, flow, shape.relative_sd, exponent=exponent, parameters=open_loop.parameters)
            b, e = b + rate, e + both.mass_flow_kg_s
            variance += both.relative_sd**2 / WINDOWS
        if n % WEIGHT_LOADS == 0:
            weight_error = WEIGHT_SD * rng.standard_normal()
        # The daemon's bias is the one that was right at the season's start.
        off = -slope * (restitution - START.restitution) + weight_error + KERNEL_RANDOM_SD * rng.standard_normal()
        kernels = truth * np.exp(off)
        doubt = np.hypot(slope * DRIFT * START.restitution * progress, np.hypot(WEIGHT_SD, KERNEL_RANDOM_SD))
        share = variance / (variance + doubt**2)
        f = float(np.exp((1.0 - share) * np.log(e) + share * np.log(kernels)))
        g = f * scale
        for name, mass in zip("befg", (b, e, f, g), strict=True):
            errors[name].append(100.0 * (mass / truth - 1.0))
        if n in TICKETS:
            scale = truth / f
    return {
        "seed": seed, "signs": signs.tolist(), "no_shape": refused,
        **{f"{name}_mean_abs_pct": round(float(np.mean(np.abs(found))), 2) for name, found in errors.items()},
    }  # fmt: skip


def report(seeds: int, first: int) -> dict[str, Any]:
    """A row for each season, and their mean."""
    rows = [season(first + i) for i in range(seeds)]
    names = [f"{name}_mean_abs_pct" for name in "befg"]
    return {
        "loads": LOADS, "windows": WINDOWS, "seasons": rows,
        "mean": {name: round(float(np.mean([row[name] for row in rows])), 2) for name in names},
        "largest": {name: round(float(np.max([row[name] for row in rows])), 2) for name in names},
        "e_halves_b": sum(row["e_mean_abs_pct"] <= 0.5 * row["b_mean_abs_pct"] for row in rows),
        "f_below_2_pct": sum(row["f_mean_abs_pct"] < 2.0 for row in rows),
    }  # fmt: skip
