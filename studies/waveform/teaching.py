"""Load errors of a season in which kernel noise teaches the parameters, with the one bias that all its lessons share.

Forces are the virtual combine's parcels; friction, density and restitution begin at values drawn from the calibration's
deviations and drift by up to 15 %. Kernel noise is not simulated by kernels: its flow is the true one times a bias drawn once a
season, which goes with restitution as in discrete elements, with 1 % of chance a load. Updates are those of the daemon.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.waveform.season import DRIFT, HOME_RAD, MACHINE, SPEED_RAD_S, bias_slope
from yieldmon.estimation import common_bias
from yieldmon.estimation.closed_loop import update_from_tickets
from yieldmon.estimation.closed_loop_inputs import MassAnchor
from yieldmon.estimation.closed_loop_outcome import Outcome
from yieldmon.estimation.common_bias import CommonBias, KernelLesson
from yieldmon.estimation.drift_rates import DriftRates
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.steady_drift import advance, begin, learn
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


def forces(grain: Grain, flows: Array, angles_rad: Array) -> Array:
    """Mean force on the plate, N, of flows (m,), kg/s, at angles (m,)."""
    gaps, speed = np.asarray(MACHINE.paddle_spacings_m), MACHINE.paddle_speed_m_s(SPEED_RAD_S)
    out = np.empty(flows.size)
    for angle in np.unique(angles_rad):
        here = angles_rad == angle
        masses = np.outer(flows[here], gaps) / speed
        parcels = throw(MACHINE, grain, Effects(), masses.ravel(), float(angle), SPEED_RAD_S, cells=150)
        impulse = np.asarray(parcels.impulse_n_s).reshape((*masses.shape, -1)).sum(axis=(1, 2))
        out[here] = impulse * speed / gaps.sum()
    return out


class DriftingSeason:
    """Loads of one season: grain that drifts away from the calibration, and what the daemon knows of it.

    Parameters
    ----------
    seed : int
    stops_deg : collection of float
        Plate angles of a sweep that falls due in each load; none by default.
    model_error : float
        Relative standard deviation of the model's error at each of these angles, which is drawn once.

    Attributes
    ----------
    known : DriftingParameters
    bias : CommonBias or None
        Of kernel noise, once it has taught.
    error_at : dict of float to float
        The model's relative error by stop, deg.
    grain : Grain
        Of the last load.
    sweep_flow_kg_s : float
        Flow of the last load's sweep; nan without stops.
    """

    def __init__(self, seed: int, stops_deg: Collection[float] = (), model_error: float = 0.0) -> None:
        self._rng = rng = np.random.default_rng(seed)
        self._signs, self._slope = rng.uniform(-1.0, 1.0, size=3), bias_slope()
        self.grain = start = Grain()
        self._values = {
            "friction": start.friction, "density": start.bulk_density_kg_m3, "shape_ratio": start.shape_ratio,
            "restitution": start.restitution, "gravity.acceleration_m_s2": 9.81,
        }  # fmt: skip
        names = tuple(KNOWN_SD)
        self.known = begin(ParameterSet(self._values, names, np.diag([KNOWN_SD[name] ** 2 for name in names])), {})
        self._off = {name: rng.normal(0.0, KNOWN_SD[name]) for name in names}
        self.error_at = {angle: rng.normal(0.0, model_error) for angle in sorted(set(stops_deg))}
        self._log_bias = rng.normal(0.0, LASTING_SD)
        self.bias: CommonBias | None = None
        self.sweep_flow_kg_s = float("nan")

    def load(self, number: int, *, teaches: bool, ticket: bool) -> tuple[float, float]:
        """The load's relative error and stated deviation, before its own lesson of kernel noise and its ticket are learnt."""
        rng, size, values, start = self._rng, np.ones(WINDOWS), self._values, Grain()
        now = [
            (values[name] + off) * (1.0 + DRIFT * sign * (number + 0.5) / LOADS)
            for (name, off), sign in zip(self._off.items(), self._signs, strict=True)
        ]
        self.grain = Grain(now[0], now[2], now[1], start.shape_ratio)
        flows = rng.uniform(5.0, 12.0, WINDOWS)
        if self.error_at:
            self.sweep_flow_kg_s = float(rng.uniform(5.0, 12.0))
        force = forces(self.grain, flows, HOME_RAD * size)
        found = OpenLoop(MODEL, self.known.parameters).estimate(force, HOME_RAD * size, SPEED_RAD_S * size)
        measured = np.asarray(found.mass_flow_kg_s)
        error, stated = float(measured.sum() / flows.sum() - 1.0), float(np.mean(np.asarray(found.std_dev_kg_s) / measured))
        self.known, step = advance(self.known, DriftRates(), LOAD_KG / flows.mean() / 3600.0, LOAD_KG)
        if self.bias is not None:
            self.bias = common_bias.carried(self.bias, step.transition, LOAD_KG)
        chance = rng.normal(0.0, CHANCE_SD)
        heard = flows * np.exp(self._log_bias + self._slope * (now[2] - values["restitution"]) + chance)
        weighed_kg = LOAD_KG * (1.0 + rng.normal(0.0, TICKET_SD))
        if teaches:
            bias = self.bias or common_bias.begin(LASTING_SD, len(self.known.joint))
            lesson = KernelLesson(heard, force, HOME_RAD * size, SPEED_RAD_S * size, np.nan * size, CHANCE_SD, LASTING_SD)
            taught = common_bias.teach(MODEL, self.known, bias, lesson)
            self.known, self.bias = taught.drifting, taught.bias
        if ticket:
            anchor = MassAnchor.from_windows(
                weighed_kg, TICKET_SD * weighed_kg, LOAD_KG / flows.sum() * size, force, HOME_RAD * size, SPEED_RAD_S * size
            )
            self.learn(update_from_tickets(MODEL, self.known.parameters, [anchor]))
        return error, stated

    def learn(self, outcome: Outcome) -> None:
        """Take what a ticket or a sweep changed."""
        if not outcome.updated:
            return
        after = learn(self.known, outcome.parameter_set, widening=outcome.prior_widening)
        if self.bias is not None:
            self.bias = common_bias.followed(self.bias, self.known, after, widening=outcome.prior_widening)
        self.known = after


def season(seed: int, *, teaches: bool, tickets: tuple[int, ...], loads: int = LOADS) -> list[tuple[float, float]]:
    """Relative error and stated deviation of each of the first loads, before its own lesson and ticket."""
    of = DriftingSeason(seed)
    return [of.load(load, teaches=teaches, ticket=load in tickets) for load in range(loads)]


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
