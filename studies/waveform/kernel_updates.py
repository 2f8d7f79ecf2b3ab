"""Load errors of a season in which kernel noise updates the parameters, with the one bias that all its updates share.

Forces are the virtual combine's parcels; friction, density and restitution begin at values drawn from the calibration's
deviations and drift, either steadily by up to 15 % or as the daemon's rates say. Kernel noise is not simulated by kernels: its
flow is the true one times a bias drawn once a season, which goes with restitution as in discrete elements (or wanders as the
daemon expects), with 1 % of chance a load. Updates and rates are those of the daemon.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.waveform.season import DRIFT, HOME_RAD, MACHINE, SPEED_RAD_S, bias_slope
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.estimation.fitting.identifiability import natural_scale
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration import drift_spread
from yieldmon.estimation.self_calibration.closed_loop import update_from_tickets
from yieldmon.estimation.self_calibration.closed_loop_inputs import WeighedMass
from yieldmon.estimation.self_calibration.closed_loop_outcome import Outcome
from yieldmon.estimation.self_calibration.steady_drift import advance, begin, forgotten, updated, widened
from yieldmon.estimation.waveform import common_bias
from yieldmon.estimation.waveform.common_bias import WANDER as BIAS_WANDER
from yieldmon.estimation.waveform.common_bias import CommonBias, KernelMeasurement
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
    "kernels update": (True, ()),
    "one ticket": (False, (0,)),
    "one ticket, kernels update": (True, (0,)),
    "a ticket after each third": (False, (0, 8, 16)),
    "a ticket after each third, kernels update": (True, (0, 8, 16)),
}
MODEL = ForwardModel(MACHINE, ("gravity",))
RATES = CalibratorSettings()
"""How the daemon expects parameters to drift, steady rates among them."""
_PER_KT = DRIFT / 3.0**0.5 / (LOADS * LOAD_KG / 1e6)
_FAST = replace(RATES, steady_per_kilotonne={"friction": _PER_KT, "density": _PER_KT, "restitution": _PER_KT * 0.55 / 1.55})
SEASONS = {
    "drifts as the default rates say": (RATES, True),
    "15 %, default rates": (RATES, False),
    "15 %, rates of that size": (_FAST, False),
}
"""What the daemon expects, and whether the grain drifts so."""


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
    rates : CalibratorSettings
        How the daemon expects the grain to drift.
    as_expected : bool
        Whether it does; else steadily by up to 15 % over the season.

    Attributes
    ----------
    known : DriftingParameters
    bias : CommonBias or None
        Of kernel noise, once it has updated them.
    error_at : dict of float to float
        The model's relative error by stop, deg.
    grain : Grain
        Of the last load.
    sweep_flow_kg_s : float
        Flow of the last load's sweep; nan without stops.
    """

    def __init__(
        self,
        seed: int,
        stops_deg: Collection[float] = (),
        model_error: float = 0.0,
        *,
        rates: CalibratorSettings = RATES,
        as_expected: bool = False,
    ) -> None:
        self._rates, self._as_expected = rates, as_expected
        self._rng = rng = np.random.default_rng(seed)
        self._signs, self._slope = rng.uniform(-1.0, 1.0, size=3), bias_slope()
        self.grain = start = Grain()
        self._values = {
            "friction": start.friction, "density": start.bulk_density_kg_m3, "shape_ratio": start.shape_ratio,
            "restitution": start.restitution, "gravity.acceleration_m_s2": 9.81,
        }  # fmt: skip
        names = tuple(KNOWN_SD)
        self.known = begin(
            ParameterSet(self._values, names, np.diag([KNOWN_SD[name] ** 2 for name in names])), rates.steady_per_kilotonne
        )
        self._spread = drift_spread.begin(self.known.joint, len(self.known.names))
        self._off = {name: rng.normal(0.0, KNOWN_SD[name]) for name in names}
        self.error_at = {angle: rng.normal(0.0, model_error) for angle in sorted(set(stops_deg))}
        self._log_bias = rng.normal(0.0, LASTING_SD)
        self._steady = {name: rng.normal(0.0, rates.steady_per_kilotonne[name]) for name in names} if as_expected else {}
        self.bias: CommonBias | None = None
        self.sweep_flow_kg_s = float("nan")

    def load(self, number: int, *, kernels_update: bool, ticket: bool) -> tuple[float, float]:
        """The load's relative error and stated deviation, before its own update of kernel noise and its ticket are learnt."""
        rng, size, values, start, rates = self._rng, np.ones(WINDOWS), self._values, Grain(), self._rates
        now = self._drifted(number)
        self.grain = Grain(now[0], now[2], now[1], start.shape_ratio)
        flows = rng.uniform(5.0, 12.0, WINDOWS)
        if self.error_at:
            self.sweep_flow_kg_s = float(rng.uniform(5.0, 12.0))
        force = forces(self.grain, flows, HOME_RAD * size)
        found = OpenLoop(MODEL, self._as_stated()).estimate(force, HOME_RAD * size, SPEED_RAD_S * size)
        measured = np.asarray(found.mass_flow_kg_s)
        error, stated = float(measured.sum() / flows.sum() - 1.0), float(np.mean(np.asarray(found.std_dev_kg_s) / measured))
        expected = {"per_kilotonne": rates.steady_per_kilotonne, "memory_kt": rates.steady_drift_memory_kt}
        added = forgotten(self.known, LOAD_KG, **expected)  # type: ignore[arg-type]
        hours = LOAD_KG / flows.mean() / 3600.0
        self.known, step = advance(self.known, rates.drift, hours, LOAD_KG, **expected)  # type: ignore[arg-type]
        self._spread = drift_spread.advanced(self._spread, step.transition, added)
        if self.bias is not None:
            self.bias = common_bias.carried(self.bias, step.transition, LOAD_KG)
        chance = rng.normal(0.0, CHANCE_SD)
        with_restitution = 0.0 if self._as_expected else self._slope * (now[2] - values["restitution"])
        heard = flows * np.exp(self._log_bias + with_restitution + chance)
        weighed_kg = LOAD_KG * (1.0 + rng.normal(0.0, TICKET_SD))
        if kernels_update:
            bias = self.bias or common_bias.begin(LASTING_SD, len(self.known.joint))
            measurement = KernelMeasurement(
                heard, force, HOME_RAD * size, SPEED_RAD_S * size, np.nan * size, CHANCE_SD, LASTING_SD
            )
            learnt = common_bias.update(MODEL, self.known, bias, measurement)
            self.known, self.bias = learnt.drifting, learnt.bias
            self._spread = drift_spread.updated(self._spread, learnt.errors)
        if ticket:
            mass = WeighedMass.from_windows(
                weighed_kg, TICKET_SD * weighed_kg, LOAD_KG / flows.sum() * size, force, HOME_RAD * size, SPEED_RAD_S * size
            )
            self.learn(update_from_tickets(MODEL, self.known.parameters, [mass]))
        return error, stated

    def _as_stated(self) -> ParameterSet:
        """What is known, with the covariance that a flow's deviation is stated by."""
        known = self.known.parameters
        return replace(known, covariance=known.covariance + drift_spread.beyond(self._spread, len(known.covariance_names)))

    def _drifted(self, number: int) -> list[float]:
        """The grain's friction, density and restitution in a load."""
        values, off, grain_kt = self._values, self._off, LOAD_KG / 1e6
        if not self._as_expected:
            late = DRIFT * (number + 0.5) / LOADS
            return [(values[name] + off[name]) * (1.0 + late * sign) for name, sign in zip(off, self._signs, strict=True)]
        rng, drift = self._rng, self._rates.drift
        left = float(np.exp(-grain_kt / self._rates.steady_drift_memory_kt))
        for name, likely in self._rates.steady_per_kilotonne.items():
            size = natural_scale(name, values[name] + off[name])
            walk = drift.per_root_kilotonne[name] ** 2 * grain_kt
            off[name] += size * (self._steady[name] * grain_kt + rng.normal(0.0, walk**0.5))
            self._steady[name] = left * self._steady[name] + rng.normal(0.0, likely * (1.0 - left**2) ** 0.5)
        self._log_bias += rng.normal(0.0, BIAS_WANDER * grain_kt**0.5)
        return [values[name] + by for name, by in off.items()]

    def learn(self, outcome: Outcome) -> None:
        """Take what a ticket or a sweep changed."""
        if not outcome.updated:
            return
        before, widening, bias = self.known, outcome.prior_widening, self.bias
        after = updated(before, outcome.parameter_set, widening=widening)
        prior = _joined(widened(before.joint, before.parameters.covariance_names, widening), bias)
        if bias is not None:
            self.bias = common_bias.followed(bias, before, after, widening=widening)
        self._spread = drift_spread.updated(self._spread, drift_spread.by_update(prior, _joined(after.joint, self.bias)))
        self.known = after


def _joined(joint: Array, bias: CommonBias | None) -> Array:
    return drift_spread.with_bias(joint, None if bias is None else (bias.cross, bias.variance))


def season(
    seed: int,
    *,
    kernels_update: bool,
    tickets: tuple[int, ...],
    loads: int = LOADS,
    rates: CalibratorSettings = RATES,
    as_expected: bool = False,
) -> list[tuple[float, float]]:
    """Relative error and stated deviation of each of the first loads, before its own update and ticket."""
    of = DriftingSeason(seed, rates=rates, as_expected=as_expected)
    return [of.load(load, kernels_update=kernels_update, ticket=load in tickets) for load in range(loads)]


def report(seeds: int, seed: int) -> dict[str, Any]:
    """Mean absolute load error of all seasons and of the worst, mean of the stated deviation, and rms error over it."""
    rows: dict[str, dict[str, dict[str, float]]] = {}
    for grain, (rates, as_expected) in SEASONS.items():
        for name, (kernels_update, tickets) in WAYS.items():
            found = np.array(
                [
                    season(seed + i, kernels_update=kernels_update, tickets=tickets, rates=rates, as_expected=as_expected)
                    for i in range(seeds)
                ]
            )
            errors, stated = found[..., 0], found[..., 1]
            by_season = np.abs(errors).mean(axis=1)
            rows.setdefault(grain, {})[name] = {
                "mean_pct": round(100.0 * float(by_season.mean()), 2),
                "worst_season_pct": round(100.0 * float(by_season.max()), 2),
                "stated_pct": round(100.0 * float(stated.mean()), 2),
                "error_over_stated_rms": round(float(np.sqrt(np.mean((errors / stated) ** 2))), 2),
            }
    return {"seed": seed, "seasons": seeds, "ways": rows}
