"""Whether a sweep after a ticket may move the flow at home: a linear copy of the filter over many seasons and laws of drift.

A season's loads and their sensitivities (`best_live.sensitivities`), and seasons drawn with their own calibration, scatter and,
where the law is random, drift. The filter is the daemon's: parameters, slopes of moisture and rates with its random walk and
memory, a ticket a day with its widening, sweeps that say the ratios of the force at 40 and at 90 deg to that at home, and of a
sweep nothing along directions of too little information. The gains are the filter's own, the truth is not: it drifts as the law
says, wear is no parameter, and slopes are off as in the season.

Ways: tickets alone; sweeps as the filter has it; sweeps after which the gain makes up for what they did to the flow at home
("restored"); and the gains of least variance under the condition that they leave the flow at home ("constrained").
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.season.best_live import GRAIN, READ_SD, load_sd, prior_of, sensitivities, tickets_at
from studies.season.season import Season, SeasonSettings
from studies.season.study import Array, StudySettings
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.drift_rates import KG_PER_KT
from yieldmon.physics.effects.moisture_dependence import REFERENCE_PCT

WAYS = ("tickets", "sweeps", "restored", "constrained")
LAWS = ("steady", "reversed", "fast at first", "slow at first", "none", "any size", "random walk", "one jump", "eight jumps")
_CONTRADICTS = 10.83
"""Square of a ticket's departure over its variance, above which the parameters are widened: one in a thousand."""
_WIDENINGS = 4


@dataclass(frozen=True)
class _Harvest:
    """Of each load: sensitivities as of `best_live`, mass in kilotonnes, share of the season, moisture beyond the map's
    reference, e / (1 + e), relative deviations of its own noise and of a ticket, and whether it has a ticket."""

    mass: Array
    ratios: Array
    kt: Array
    progress: Array
    wetter: Array
    gain: Array
    own_sd: Array
    ticket_sd: Array
    weighed: NDArray[np.bool_]
    every: int


def home_flow(
    season: Season, first: ParameterSet, harvest: SeasonSettings, kept: StudySettings, *, seasons: int, common_error: float = 0.0
) -> dict[str, Any]:
    """Mean live error (%) and share within 1 % by law of drift and way.

    seasons: drawn for each law. common_error: relative error of the model's force at 40 deg against that at home, the same in all
    sweeps; half of it, of the other sign, at 90 deg.
    """
    loads, middle = season.loads, (season.loads.start + season.loads.end) // 2
    of, own = sensitivities(season), load_sd(season)
    moisture = np.array([np.mean(season.moisture_pct[a:b]) for a, b in zip(loads.start, loads.end, strict=True)])
    days = (season.time_s[loads.end - 1] // kept.day_s).astype(int)
    known = _Harvest(
        of.mass,
        of.ratios,
        loads.mass_kg / KG_PER_KT,
        season.time_s[middle] / (3600.0 * harvest.hours),
        moisture - REFERENCE_PCT,
        season.restitution[middle] / (1.0 + season.restitution[middle]),
        own,
        np.hypot(kept.ticket_sd_kg / loads.mass_kg, kept.reference_error),
        tickets_at(days, 1),
        max(1, round(kept.sweep_interval_s / float(np.mean(loads.end - loads.start)))),
    )
    error = common_error * np.array([1.0, -0.5])
    found: dict[str, Any] = {}
    for law in LAWS:
        for way in WAYS:
            off = 100.0 * np.abs(_errors(known, first, harvest, kept, law, way, seasons, error))
            found[f"{law}, {way}"] = [round(float(np.mean(off)), 3), round(float(np.mean(off <= 1.0)), 3)]
    for way in WAYS:
        each = np.array([found[f"{law}, {way}"] for law in LAWS])
        found[f"mean of laws, {way}"] = [round(float(v), 3) for v in each.mean(axis=0)]
    return found


def _drift(known: _Harvest, harvest: SeasonSettings, law: str, count: int, rng: np.random.Generator) -> Array:
    """(count, loads, 3): ln of friction and of 1 + restitution, and wear, mm, since the start."""
    size = np.stack([np.full_like(known.gain, harvest.friction_drift), harvest.restitution_drift * known.gain], axis=-1)
    size = np.concatenate((size, np.full((len(size), 1), harvest.wear_mm)), axis=-1)
    along: Array = known.progress[:, None] * np.ones(3)
    if law == "reversed":
        along = along * np.array([-1.0, -1.0, 0.0])
    elif law in ("fast at first", "slow at first"):
        along = along ** (0.5 if law == "fast at first" else 2.0)
    elif law == "none":
        along = 0.0 * along
    if law == "any size":
        sizes = rng.standard_normal((count, 1, 3))
        sizes[..., 2] = np.abs(sizes[..., 2])
        return along * sizes * size
    if law == "random walk":
        share = np.sqrt(np.diff(known.progress, prepend=0.0))[:, None]
        return np.asarray(np.cumsum(share * rng.standard_normal((count, len(size), 3)), axis=1) * size)
    if law in ("one jump", "eight jumps"):
        jumps = 1 if law == "one jump" else 8
        wear, found = along[:, 2] * size[:, 2], np.zeros((count, len(size), 3))
        for number in range(jumps):
            at = (number + rng.uniform(size=(count, 1))) / jumps if jumps > 1 else rng.uniform(0.2, 0.8, (count, 1))
            by = 0.5 * rng.standard_normal((count, 1, 2)) if jumps > 1 else np.ones((1, 1, 2))
            found[..., :2] += (known.progress > at)[..., None] * by * size[:, :2]
        found[..., 2] = wear
        return found
    return np.broadcast_to(along * size, (count, len(size), 3))


def _true(known: _Harvest, harvest: SeasonSettings, kept: StudySettings, law: str, count: int, rng: np.random.Generator) -> Array:
    """(count, loads, 4): ln of friction, 1 + restitution and density beside the map's, and wear, mm."""
    drift, slopes = _drift(known, harvest, law, count, rng), harvest.moisture_dependence
    off = np.array([getattr(slopes, f"{name}_per_pct") - kept.map_mean[f"{name}_per_pct"] for name in GRAIN])
    by_moisture = (
        known.wetter[:, None] * off * np.stack([np.ones_like(known.gain), known.gain, np.ones_like(known.gain)], axis=-1)
    )
    true = np.zeros((count, len(known.gain), 4))
    true[..., :3] = by_moisture
    true[..., :2] += drift[..., :2]
    true[..., 3] = drift[..., 2]
    return true


def _errors(
    known: _Harvest,
    first: ParameterSet,
    harvest: SeasonSettings,
    kept: StudySettings,
    law: str,
    way: str,
    count: int,
    common_error: Array,
) -> Array:
    """Relative live error of each load, (count, loads)."""
    rng = np.random.default_rng(1)
    true = _true(known, harvest, kept, law, count, rng)
    prior = np.zeros((9, 9))
    prior[:6, :6] = prior_of(first, kept)[:6, :6]
    rates, walk = (np.array([of.get(name, 0.0) for name in GRAIN]) for of in _drifts(kept))
    prior[6:, 6:] = np.diag(rates**2)
    state, covariance = np.zeros((count, 9)), np.broadcast_to(prior, (count, 9, 9)).copy()
    state[:, :3] = rng.multivariate_normal(np.zeros(3), prior[:3, :3], count)
    own, of_tickets = (sd * rng.standard_normal((count, len(known.kt))) for sd in (known.own_sd, known.ticket_sd))
    reading = READ_SD * rng.standard_normal((count, len(known.kt), 2))
    errors, weighed = np.empty(own.shape), False
    for i in range(len(known.kt)):
        state, covariance = _later(state, covariance, known.kt[i], rates, walk, kept.steady_drift_memory_kt)
        of_state = np.zeros((3, 9))
        of_state[:3, :3] = np.eye(3)
        of_state[:, 3:6] = known.wetter[i] * np.diag([1.0, known.gain[i], 1.0])
        home, here = known.mass[:3, i] @ of_state, true[:, i] * np.array([1.0, 1.0, 1.0, -1.0])
        if way != "tickets" and i % known.every == known.every - 1:
            rows = known.ratios[:, :3, i] @ of_state
            seen = here @ known.ratios[:, :, i].T - state @ rows.T + reading[:, i] + common_error
            noise = np.eye(2) * (READ_SD**2 + kept.model_error**2)
            gain = _informed_gain(covariance, rows, noise, kept.learned_information)
            if weighed and way in ("restored", "constrained"):
                moved = home @ gain
                if way == "restored":
                    gain[:, 1] -= moved / home[1]
                else:
                    tie = covariance @ home
                    gain -= tie[:, :, None] * moved[:, None, :] / (tie @ home)[:, None, None]
            state = state + np.einsum("dij,dj->di", gain, seen)
            covariance = _joseph(covariance, gain, rows, noise)
        off = state @ home - here @ known.mass[:, i]
        errors[:, i] = off + own[:, i]
        if known.weighed[i]:
            departure, variance = of_tickets[:, i] - errors[:, i], known.ticket_sd[i] ** 2
            wider, of_flow = np.ones(count), covariance @ home @ home
            for _ in range(_WIDENINGS):
                wider = np.where(departure**2 > _CONTRADICTS * (wider * of_flow + variance), 4.0 * wider, wider)
            covariance[:, :6, :6] *= wider[:, None, None]
            tie = covariance @ home
            gain = (tie / (tie @ home + variance)[:, None])[:, :, None]
            state = state + gain[:, :, 0] * departure[:, None]
            covariance = _joseph(covariance, gain, home[None], np.array([[variance]]))
            weighed = True
    return errors


def _drifts(kept: StudySettings) -> tuple[Mapping[str, float], Mapping[str, float]]:
    return kept.steady_per_kilotonne, kept.wandering.per_root_kilotonne


def _later(state: Array, covariance: Array, kt: float, rates: Array, walk: Array, memory_kt: float) -> tuple[Array, Array]:
    """After a load: rates move the parameters and are forgotten, as `steady_drift.advance` has it."""
    share = kt / memory_kt
    left, transition = float(np.exp(-share)), np.eye(9)
    gone = 1.0 - left
    transition[:3, 6:] = memory_kt * gone * np.eye(3)
    transition[6:, 6:] = left * np.eye(3)
    added = np.zeros((9, 9))
    added[:3, :3] = np.diag(walk**2 * kt + rates**2 * memory_kt**2 * (2.0 * share - 2.0 * gone - gone**2))
    added[:3, 6:] = added[6:, :3] = np.diag(rates**2 * memory_kt * gone**2)
    added[6:, 6:] = np.diag(rates**2 * gone * (1.0 + left))
    return state @ transition.T, transition @ covariance @ transition.T + added


def _informed_gain(covariance: Array, rows: Array, noise: Array, least: float) -> Array:
    """Kalman gains (count, 9, 2) but along directions in which a reading says less than `least` of what was known."""
    tie = covariance @ rows.T
    signal = rows @ tie
    root = np.linalg.cholesky(noise)
    back = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(back @ signal @ back.T)
    used = (vectors * (values >= least)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray(tie @ np.linalg.inv(signal + noise) @ (root @ used @ back))


def _joseph(covariance: Array, gain: Array, rows: Array, noise: Array) -> Array:
    left = np.eye(9) - gain @ rows
    return np.asarray(left @ covariance @ np.swapaxes(left, 1, 2) + gain @ noise @ np.swapaxes(gain, 1, 2))
