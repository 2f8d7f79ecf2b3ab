"""Load errors of a season whose sweeps are made by interval, where their information suffices (`sweep.when`), or not at all.

Seasons are those of `kernel_updates`: forces of the virtual combine's parcels, grain that drifts as the daemon expects or by up
to 15 %, updates and rates of the daemon. In each load one sweep falls due, at a flow of its own. A sweep has 1 % of noise,
the model's error at each angle is drawn once a season (1 %), and the flow wanders by 5 % over 20 s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.waveform.kernel_updates import LOADS, MODEL, SEASONS, DriftingSeason, forces
from studies.waveform.season import HOME_RAD, SPEED_RAD_S
from yieldmon.engine.settings import SweepSettings
from yieldmon.engine.sweeps.sweep import sweep_sequence
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.self_calibration.closed_loop import fit_parameters
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep
from yieldmon.estimation.self_calibration.flow_process import correlation
from yieldmon.estimation.self_calibration.steady_drift import DriftingParameters
from yieldmon.estimation.self_calibration.sweep_worth import OtherChannels, SweepPlan, sweep_worth, window_times_s
from yieldmon.estimation.waveform.common_bias import CommonBias

Array = NDArray[np.float64]
NOISE_SD = 0.01
LOOP = ClosedLoopSettings(flow="process", model_error=0.01)
_S = SweepSettings()
STOPS_DEG = [
    a for a in sweep_sequence(_S.angles_deg, float(np.rad2deg(HOME_RAD)), _S.home_every) for _ in range(_S.windows_per_step)
]
TIMES_S = window_times_s(STOPS_DEG)
CASES = {"mean force": (False, ()), "one ticket": (False, (0,)), "kernels update, one ticket": (True, (0,))}
WHEN = ("never", "interval", "information")
GRAINS = ("drifts as the default rates say", "15 %, default rates")
"""Of `kernel_updates.SEASONS`."""


def _worth_making(known: DriftingParameters, flow_kg_s: float, bias: CommonBias | None) -> bool:
    channels = OtherChannels()
    if bias is not None:
        cross = tuple(float(v) for v in bias.cross[: len(known.parameters.covariance_names)])
        channels = OtherChannels(kernels_sd=bias.variance**0.5, kernels_cross=cross)
    plan = SweepPlan(TIMES_S, np.radians(STOPS_DEG), HOME_RAD, SPEED_RAD_S, flow_kg_s, NOISE_SD, float("nan"))
    worth = sweep_worth(MODEL, known.parameters, plan, channels, LOOP)
    return worth is None or worth.ratio >= _S.worth_ratio


def _swept(of: DriftingSeason, seed: int) -> None:
    rng, angles = np.random.default_rng(seed), np.radians(STOPS_DEG)
    wander = LOOP.flow_process_sd**2 * correlation(TIMES_S, LOOP.flow_process_time_s)
    flows = of.sweep_flow_kg_s * np.exp(rng.multivariate_normal(np.zeros(angles.size), wander))
    off = np.array([of.error_at[angle] for angle in STOPS_DEG]) + rng.normal(0.0, NOISE_SD, angles.size)
    force = forces(of.grain, flows, angles) * (1.0 + off)
    sweep = Sweep(TIMES_S, angles, np.full(angles.size, SPEED_RAD_S), force, NOISE_SD * force)
    of.learn(fit_parameters(MODEL, of.known.parameters, [sweep], settings=LOOP))


def season(
    seed: int, *, when: str, kernels_update: bool, tickets: tuple[int, ...], grain: str = GRAINS[1]
) -> tuple[list[float], list[float], int]:
    """Relative error and stated deviation of each load before its own sweep, update and ticket, and how many sweeps were made."""
    rates, as_expected = SEASONS[grain]
    of = DriftingSeason(seed, STOPS_DEG, LOOP.model_error, rates=rates, as_expected=as_expected)
    errors, stated, made = [], [], 0
    for load in range(LOADS):
        error, deviation = of.load(load, kernels_update=kernels_update, ticket=load in tickets)
        errors.append(error)
        stated.append(deviation)
        if when == "interval" or (when == "information" and _worth_making(of.known, of.sweep_flow_kg_s, of.bias)):
            _swept(of, seed * 1000 + load)
            made += 1
    return errors, stated, made


def report(seeds: int, seed: int) -> dict[str, Any]:
    """Sweeps a season, mean absolute load error, that of the worst season, and rms error over the stated deviation."""
    rows: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    for grain in GRAINS:
        for name, (kernels_update, tickets) in CASES.items():
            for when in WHEN:
                found = [
                    season(seed + i, when=when, kernels_update=kernels_update, tickets=tickets, grain=grain) for i in range(seeds)
                ]
                errors, stated = (np.array([one[part] for one in found]) for part in (0, 1))
                by_season = np.abs(errors).mean(axis=1)
                rows.setdefault(grain, {}).setdefault(name, {})[when] = {
                    "sweeps": round(float(np.mean([one[2] for one in found])), 1),
                    "mean_pct": round(100.0 * float(by_season.mean()), 2),
                    "worst_season_pct": round(100.0 * float(by_season.max()), 2),
                    "error_over_stated_rms": round(float(np.sqrt(np.mean((errors / stated) ** 2))), 2),
                }
    return {"seed": seed, "seasons": seeds, "loads": LOADS, "cases": rows}
