"""Load errors of a season whose sweeps are made by interval, where they would tell enough (`sweep.when`), or not at all.

Seasons are those of `teaching`: forces of the virtual combine's parcels, grain that drifts by up to 15 %, updates of the daemon.
In each load one sweep falls due, at a flow of its own. A sweep's windows have 1 % of noise, the model's error at each angle is
drawn once a season (1 %), and the flow wanders by 5 % over 20 s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.waveform.season import DRIFT, HOME_RAD, MACHINE, SPEED_RAD_S, bias_slope
from studies.waveform.teaching import CHANCE_SD, KNOWN_SD, LASTING_SD, LOAD_KG, LOADS, MODEL, TICKET_SD, WINDOWS, ticketed
from yieldmon.engine.settings import SweepSettings
from yieldmon.engine.sweep import sweep_sequence
from yieldmon.estimation import common_bias
from yieldmon.estimation.closed_loop import self_calibrate
from yieldmon.estimation.closed_loop_inputs import Sweep
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.common_bias import CommonBias, KernelLesson
from yieldmon.estimation.drift_rates import DriftRates
from yieldmon.estimation.flow_process import correlation
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.steady_drift import DriftingParameters, advance, begin, learn
from yieldmon.estimation.sweep_worth import OtherChannels, SweepPlan, sweep_worth, window_times_s
from yieldmon.plant.effects import Effects
from yieldmon.plant.grain import Grain
from yieldmon.plant.throw import throw

Array = NDArray[np.float64]
NOISE_SD = 0.01
LOOP = ClosedLoopSettings(flow="process", model_error=0.01)
_S = SweepSettings()
STOPS_DEG = [
    a for a in sweep_sequence(_S.angles_deg, float(np.rad2deg(HOME_RAD)), _S.home_every) for _ in range(_S.windows_per_step)
]
TIMES_S = window_times_s(STOPS_DEG)
CASES = {"mean force": (False, ()), "one ticket": (False, (0,)), "kernels teach, one ticket": (True, (0,))}
WHEN = ("never", "interval", "information")


def _forces(grain: Grain, flows: Array, angles_rad: Array) -> Array:
    """Of flows (m,) at angles (m,)."""
    gaps, speed = np.asarray(MACHINE.paddle_spacings_m), MACHINE.paddle_speed_m_s(SPEED_RAD_S)
    out = np.empty(flows.size)
    for angle in np.unique(angles_rad):
        here = angles_rad == angle
        masses = np.outer(flows[here], gaps) / speed
        parcels = throw(MACHINE, grain, Effects(), masses.ravel(), float(angle), SPEED_RAD_S, cells=150)
        impulse = np.asarray(parcels.impulse_n_s).reshape((*masses.shape, -1)).sum(axis=(1, 2))
        out[here] = impulse * speed / gaps.sum()
    return out


def _worth_making(known: DriftingParameters, flow_kg_s: float, bias: CommonBias | None) -> bool:
    channels = OtherChannels()
    if bias is not None:
        cross = tuple(float(v) for v in bias.cross[: len(known.parameters.covariance_names)])
        channels = OtherChannels(kernels_sd=bias.variance**0.5, kernels_cross=cross)
    plan = SweepPlan(TIMES_S, np.radians(STOPS_DEG), HOME_RAD, SPEED_RAD_S, flow_kg_s, NOISE_SD, float("nan"))
    worth = sweep_worth(MODEL, known.parameters, plan, channels, LOOP)
    return worth is None or worth.ratio >= _S.worth_ratio


def _swept(
    known: DriftingParameters, bias: CommonBias | None, grain: Grain, flow_kg_s: float, of_angle: dict[float, float], seed: int
) -> tuple[DriftingParameters, CommonBias | None]:
    rng, angles = np.random.default_rng(seed), np.radians(STOPS_DEG)
    wander = LOOP.flow_process_sd**2 * correlation(TIMES_S, LOOP.flow_process_time_s)
    flows = flow_kg_s * np.exp(rng.multivariate_normal(np.zeros(angles.size), wander))
    off = np.array([of_angle[angle] for angle in STOPS_DEG]) + rng.normal(0.0, NOISE_SD, angles.size)
    force = _forces(grain, flows, angles) * (1.0 + off)
    sweep = Sweep(TIMES_S, angles, np.full(angles.size, SPEED_RAD_S), force, NOISE_SD * force)
    outcome = self_calibrate(MODEL, known.parameters, [sweep], settings=LOOP)
    if not outcome.updated:
        return known, bias
    after = learn(known, outcome.parameter_set, widening=outcome.prior_widening)
    if bias is not None:
        bias = common_bias.followed(bias, known, after, widening=outcome.prior_widening)
    return after, bias


def season(seed: int, *, when: str, teaches: bool, tickets: tuple[int, ...]) -> tuple[list[float], list[float], int]:
    """Relative error and stated deviation of each load before its own sweep, lesson and ticket, and how many sweeps were made."""
    rng = np.random.default_rng(seed)
    signs, size, slope = rng.uniform(-1.0, 1.0, size=3), np.ones(WINDOWS), bias_slope()
    start = Grain()
    values = {
        "friction": start.friction, "density": start.bulk_density_kg_m3, "shape_ratio": start.shape_ratio,
        "restitution": start.restitution, "gravity.acceleration_m_s2": 9.81,
    }  # fmt: skip
    names = tuple(KNOWN_SD)
    known = begin(ParameterSet(values, names, np.diag([KNOWN_SD[name] ** 2 for name in names])), {})
    off = {name: rng.normal(0.0, KNOWN_SD[name]) for name in names}
    of_angle = {angle: rng.normal(0.0, LOOP.model_error) for angle in sorted(set(STOPS_DEG))}
    log_bias, bias = rng.normal(0.0, LASTING_SD), None
    errors, stated, made = [], [], 0
    for load in range(LOADS):
        now = [(values[n] + off[n]) * (1.0 + DRIFT * s * (load + 0.5) / LOADS) for n, s in zip(names, signs, strict=True)]
        grain = Grain(now[0], now[2], now[1], start.shape_ratio)
        flows, sweep_flow = rng.uniform(5.0, 12.0, WINDOWS), float(rng.uniform(5.0, 12.0))
        force = _forces(grain, flows, HOME_RAD * size)
        found = OpenLoop(MODEL, known.parameters).estimate(force, HOME_RAD * size, SPEED_RAD_S * size)
        measured = np.asarray(found.mass_flow_kg_s)
        errors.append(float(measured.sum() / flows.sum() - 1.0))
        stated.append(float(np.mean(np.asarray(found.std_dev_kg_s) / measured)))
        known, step = advance(known, DriftRates(), LOAD_KG / flows.mean() / 3600.0, LOAD_KG)
        bias = common_bias.carried(bias, step.transition, LOAD_KG) if bias is not None else None
        heard = flows * np.exp(log_bias + slope * (now[2] - values["restitution"]) + rng.normal(0.0, CHANCE_SD))
        weighed = LOAD_KG * (1.0 + rng.normal(0.0, TICKET_SD))
        if teaches:
            bias = bias or common_bias.begin(LASTING_SD, len(known.joint))
            lesson = KernelLesson(heard, force, HOME_RAD * size, SPEED_RAD_S * size, np.nan * size, CHANCE_SD, LASTING_SD)
            taught = common_bias.teach(MODEL, known, bias, lesson)
            known, bias = taught.drifting, taught.bias
        if load in tickets:
            known, bias = ticketed(known, bias, weighed, LOAD_KG / flows.sum(), force)
        if when == "interval" or (when == "information" and _worth_making(known, sweep_flow, bias)):
            known, bias = _swept(known, bias, grain, sweep_flow, of_angle, seed * 1000 + load)
            made += 1
    return errors, stated, made


def report(seeds: int, seed: int) -> dict[str, Any]:
    """Sweeps a season, mean absolute load error, that of the worst season, and rms error over the stated deviation."""
    rows: dict[str, dict[str, dict[str, float]]] = {}
    for name, (teaches, tickets) in CASES.items():
        for when in WHEN:
            found = [season(seed + i, when=when, teaches=teaches, tickets=tickets) for i in range(seeds)]
            errors, stated = (np.array([one[part] for one in found]) for part in (0, 1))
            by_season = np.abs(errors).mean(axis=1)
            rows.setdefault(name, {})[when] = {
                "sweeps": round(float(np.mean([one[2] for one in found])), 1),
                "mean_pct": round(100.0 * float(by_season.mean()), 2),
                "worst_season_pct": round(100.0 * float(by_season.max()), 2),
                "error_over_stated_rms": round(float(np.sqrt(np.mean((errors / stated) ** 2))), 2),
            }
    return {"seed": seed, "seasons": seeds, "loads": LOADS, "cases": rows}
