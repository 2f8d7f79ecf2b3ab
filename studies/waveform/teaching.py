"""Load errors of a season in which kernel noise teaches the parameters, with the one bias that all its lessons share.

Forces are the virtual combine's parcels; friction, density and restitution begin at values drawn from the calibration's
deviations and drift by up to 15 %. Kernel noise is not simulated by kernels: its flow is the true one times a bias drawn once a
season, which goes with restitution as in discrete elements, with 1 % of chance a load. Updates are those of the daemon.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.waveform.season import DRIFT, HOME_RAD, MACHINE, SPEED_RAD_S, bias_slope
from yieldmon.estimation import common_bias
from yieldmon.estimation.closed_loop import update_from_tickets
from yieldmon.estimation.closed_loop_inputs import MassAnchor
from yieldmon.estimation.common_bias import CommonBias, KernelLesson
from yieldmon.estimation.drift_rates import DriftRates
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.steady_drift import DriftingParameters, advance, begin, learn
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.effects import Effects
from yieldmon.plant.grain import Grain
from yieldmon.plant.throw import throw

Array = NDArray[np.float64]
LOADS, LOAD_KG, WINDOWS = 24, 20_000.0, 12
KNOWN_SD = {"friction": 0.02, "density": 33.0, "restitution": 0.05}
LASTING_SD = 0.134
"""Of kernel noise as shipped: bias 1.2 +- 0.15, kernels weighed to 3 %, cell and background."""
CHANCE_SD, TICKET_SD = 0.01, 0.003
WAYS = {
    "no ticket": (False, ()),
    "kernels teach": (True, ()),
    "one ticket": (False, (0,)),
    "one ticket, kernels teach": (True, (0,)),
    "a ticket after each third": (False, (0, 8, 16)),
    "a ticket after each third, kernels teach": (True, (0, 8, 16)),
}
MODEL = ForwardModel(MACHINE, ("gravity",))


def _forces(grain: Grain, flows: Array) -> Array:
    gaps, speed = np.asarray(MACHINE.paddle_spacings_m), MACHINE.paddle_speed_m_s(SPEED_RAD_S)
    masses = np.outer(flows, gaps) / speed
    parcels = throw(MACHINE, grain, Effects(), masses.ravel(), HOME_RAD, SPEED_RAD_S, cells=150)
    impulse = np.asarray(parcels.impulse_n_s).reshape((*masses.shape, -1)).sum(axis=(1, 2))
    return np.asarray(impulse * speed / gaps.sum())


def season(seed: int, *, teaches: bool, tickets: tuple[int, ...], loads: int = LOADS) -> list[tuple[float, float]]:
    """Error of each of the first loads before its own lesson and ticket, and the deviation stated, relative."""
    rng = np.random.default_rng(seed)
    signs, size, slope = rng.uniform(-1.0, 1.0, size=3), np.full(WINDOWS, 1.0), bias_slope()
    start = Grain()
    values = {
        "friction": start.friction, "density": start.bulk_density_kg_m3, "shape_ratio": start.shape_ratio,
        "restitution": start.restitution, "gravity.acceleration_m_s2": 9.81,
    }  # fmt: skip
    names = tuple(KNOWN_SD)
    known = begin(ParameterSet(values, names, np.diag([KNOWN_SD[name] ** 2 for name in names])), {})
    off = {name: rng.normal(0.0, KNOWN_SD[name]) for name in names}
    log_bias, bias = rng.normal(0.0, LASTING_SD), None
    out = []
    for load in range(loads):
        now = [(values[n] + off[n]) * (1.0 + DRIFT * s * (load + 0.5) / LOADS) for n, s in zip(names, signs, strict=True)]
        flows = rng.uniform(5.0, 12.0, WINDOWS)
        force = _forces(Grain(now[0], now[2], now[1], start.shape_ratio), flows)
        found = OpenLoop(MODEL, known.parameters).estimate(force, HOME_RAD * size, SPEED_RAD_S * size)
        measured, sd = np.asarray(found.mass_flow_kg_s), np.asarray(found.std_dev_kg_s)
        out.append((float(measured.sum() / flows.sum() - 1.0), float(np.mean(sd / measured))))
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
    return out


def ticketed(
    known: DriftingParameters, bias: CommonBias | None, weighed_kg: float, seconds: float, force: Array
) -> tuple[DriftingParameters, CommonBias | None]:
    size = np.ones(WINDOWS)
    anchor = MassAnchor.from_windows(
        weighed_kg, TICKET_SD * weighed_kg, seconds * size, force, HOME_RAD * size, SPEED_RAD_S * size
    )
    outcome = update_from_tickets(MODEL, known.parameters, [anchor])
    if not outcome.updated:
        return known, bias
    after = learn(known, outcome.parameter_set, widening=outcome.prior_widening)
    if bias is not None:
        bias = common_bias.followed(bias, known, after, widening=outcome.prior_widening)
    return after, bias


def report(seeds: int, seed: int) -> dict[str, Any]:
    """Mean absolute load error of all seasons and of the worst, mean of the stated deviation, and rms error over it."""
    rows = {}
    for name, (teaches, tickets) in WAYS.items():
        found = np.array([season(seed + i, teaches=teaches, tickets=tickets) for i in range(seeds)])
        errors, stated = found[..., 0], found[..., 1]
        by_season = np.abs(errors).mean(axis=1)
        rows[name] = {
            "mean_pct": round(100.0 * float(by_season.mean()), 2),
            "worst_season_pct": round(100.0 * float(by_season.max()), 2),
            "stated_pct": round(100.0 * float(stated.mean()), 2),
            "error_over_stated_rms": round(float(np.sqrt(np.mean((errors / stated) ** 2))), 2),
        }
    return {"seed": seed, "seasons": seeds, "ways": rows}
