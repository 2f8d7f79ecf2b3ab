"""The most that any estimator can have right live by tickets, if it knows how the season drifts but not by how much.

A Kalman filter with the season's own drift: friction, restitution and wear move at steady rates, the moisture map's slopes are
off by constants. Rates are drawn with the deviation that the season's drift has, slopes and the calibration with those stated;
there is no random walk. Linear in the logarithm of a load's mass, so that the deviations do not depend on what was measured;
of all estimates the mean of a normal distribution is within 1 % most often. Each load's own zero and noise count as well.

Beside the tickets: nothing; friction with every load; the ratios of the force at 40 and 90 deg to that at home, as a sweep reads
them (at the daemon's interval, and with every load) and exactly. They are all that a sweep can say, of friction and of fill.

"Worse" is the share of seasons like this one, drawn with their own drift, slopes and calibration, in which the filter that is
told the sweeps as they read has a larger mean live error than the one that is told the tickets alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from studies.season.season import Season, SeasonSettings
from studies.season.study import Array, StudySettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.effects.moisture_dependence import REFERENCE_PCT
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import Conditions, ForwardModel

GRAIN = ("friction", "restitution", "density")
TICKETS_A_DAY = (1, 2, 4, 8)
SWEPT_DEG = (40.0, 90.0)
SWEEP_SD = 0.015
"""Relative, of a ratio that one sweep reads: four visits of two windows with 7 % scatter, and a flow that changes by 2 % between
a visit and those home around it. It changes by more in these seasons, so that sweeps say less than is taken here."""
READ_SD = 0.033
"""The same as sweeps of these seasons read it: friction to 24 % each (`sweep_readings.py`), by the two ratios together."""
_KNOWN = 1e-4
"""Relative standard deviation of what is told exactly."""
_STEP = 0.01
POSTED_DAYS = 3
"""That a posting reaches back over."""
_ZERO_TIME_S = 600.0
_SEASONS = 400
"""Drawn, of a like harvest, each with its own drift, slopes and calibration."""


@dataclass(frozen=True)
class Sensitivities:
    """Changes with what is believed: by ln of friction, 1 + restitution and density, and by mm of wear that the machine has and
    the model does not know. mass: (4, loads) of a load's ln(mass). ratios: (angles, 4, loads) of ln of the force at an angle over
    that at home, at the flow that the force at home gives."""

    mass: Array
    ratios: Array


def best_live(season: Season, first: ParameterSet, harvest: SeasonSettings, kept: StudySettings) -> dict[str, Any]:
    """Expected shares of the loads within 1 % live and posted, 0 to 1, by what is told beside the tickets and by tickets a day.

    first: the calibration at the season's start. kept: what its map's slopes and tickets are known to, and the length of a day.
    """
    loads = season.loads
    middle = (loads.start + loads.end) // 2
    moisture = np.array([np.mean(season.moisture_pct[a:b]) for a, b in zip(loads.start, loads.end, strict=True)])
    progress = season.time_s[middle] / (3600.0 * harvest.hours)
    found = sensitivities(season)
    # State: ln friction, ln (1 + e), ln density at the start; the map's slopes; friction's, (1 + e)'s and the wear's share of
    # the season's drift.
    gain = season.restitution[middle] / (1.0 + season.restitution[middle])
    wetter = moisture - REFERENCE_PCT
    along = np.zeros((4, middle.size, 9))
    for row, (own, slope) in enumerate(((1.0, 1.0), (1.0, gain), (1.0, 1.0))):
        along[row, :, row] = own
        along[row, :, 3 + row] = slope * wetter
    along[0, :, 6] = harvest.friction_drift * progress
    along[1, :, 7] = harvest.restitution_drift * progress * gain
    along[3, :, 8] = harvest.wear_mm * progress
    rows, own_sd = np.einsum("gl,gls->ls", found.mass, along), load_sd(season)
    ratios = np.einsum("agl,gls->als", found.ratios, along)
    every = max(1, round(kept.sweep_interval_s / float(np.mean(loads.end - loads.start))))
    swept = np.arange(middle.size) % every == 0
    always = np.ones(middle.size, dtype=bool)
    told: dict[str, list[_Told]] = {
        "no sweeps": [],
        "sweeps as they read": [_Told(ratio, READ_SD, swept) for ratio in ratios],
        "sweeps": [_Told(ratio, SWEEP_SD, swept) for ratio in ratios],
        "a sweep with every load": [_Told(ratio, SWEEP_SD, always) for ratio in ratios],
        "friction known": [_Told(along[0], _KNOWN, always)],
        "ratios known": [_Told(ratio, _KNOWN, always) for ratio in ratios],
    }
    days = (season.time_s[loads.end - 1] // kept.day_s).astype(int)
    shares: dict[str, Any] = {}
    ticket_sd = np.hypot(np.hypot(kept.ticket_sd_kg / loads.mass_kg, kept.reference_error), own_sd)
    alone, swept_too = (
        _errors(rows, told[label], prior_of(first, kept), tickets_at(days, 1), ticket_sd, own_sd)
        for label in ("no sweeps", "sweeps as they read")
    )
    means = [np.mean(np.abs(errors), axis=1) for errors in (alone, swept_too)]
    shares["mean_pct, no sweeps and sweeps as they read"] = [round(100.0 * float(np.mean(mean)), 3) for mean in means]
    shares["seasons that sweeps as they read make worse"] = round(float(np.mean(means[1] > means[0])), 3)
    shares["difference of a season, sd"] = round(100.0 * float(np.std(means[1] - means[0])), 3)
    for tickets in TICKETS_A_DAY:
        weighed = tickets_at(days, tickets)
        for label, beside in told.items():
            live, posted = _sd(rows, beside, prior_of(first, kept), weighed, ticket_sd, days)
            share, share_posted = (erf(0.01 / (np.sqrt(2.0) * np.hypot(sd, own_sd))) for sd in (live, posted))
            name = label if tickets == 1 else f"{label}, {tickets} tickets a day"
            shares[name] = round(float(np.mean(share)), 3)
            shares[f"{name}, posted"] = round(float(np.mean(share_posted)), 3)
            if tickets == 1:
                shares[f"{label}, by day"] = [round(float(np.mean(share[days == day])), 2) for day in range(int(days[-2]) + 1)]
    return shares


def load_sd(season: Season) -> Array:
    """Relative standard deviation of each load by its own zero and noise, (loads,)."""
    found = []
    for a, b in zip(season.loads.start, season.loads.end, strict=True):
        windows = np.arange(a, b)[season.mass_flow_kg_s[a:b] > 0.0]
        force, sigma = season.measure(windows, float(np.degrees(season.machine.home_plate_angle_rad)))
        steps = (b - a) / _ZERO_TIME_S
        averaged = np.sqrt(2.0 * (steps - 1.0 + np.exp(-steps))) / steps
        zero_n = float(np.std(season.zero_error_n)) * averaged * windows.size
        found.append(float(np.hypot(zero_n, np.sqrt(np.sum(sigma**2))) / np.sum(force)))
    return np.array(found)


def sensitivities(season: Season) -> Sensitivities:
    """Of each load, at its mean flow and the grain in its middle."""
    machine, middle = season.machine, (season.loads.start + season.loads.end) // 2
    flow = np.array([np.mean(season.mass_flow_kg_s[a:b]) for a, b in zip(season.loads.start, season.loads.end, strict=True)])
    model = ForwardModel(machine, ("gravity",))
    worn = ForwardModel(replace(machine, paddle_length_m=machine.paddle_length_m - 1e-3), ("gravity",))
    angles = np.array([machine.home_plate_angle_rad, *np.radians(SWEPT_DEG)])
    mass, ratios = np.empty((4, middle.size)), np.empty((len(SWEPT_DEG), 4, middle.size))
    for i, window in enumerate(middle):
        speed = float(season.elevator_speed_rpm[window]) * RPM
        values = {
            "friction": float(season.friction[window]),
            "restitution": float(season.restitution[window]),
            "density": float(season.density_kg_m3[window]),
            "shape_ratio": 2.0,
            "gravity.acceleration_m_s2": 9.81,
        }
        true, less = (_forces(law, values, angles, speed, float(flow[i])) for law in (model, worn))
        for row, name in enumerate((*GRAIN, None)):
            believed, seen, step = dict(values), true if name else less, _STEP if name else 1.0
            if name:
                offset = 1.0 if name == "restitution" else 0.0
                believed[name] = (values[name] + offset) * (1.0 + _STEP) - offset
            found = float(OpenLoop(model, ParameterSet(believed)).invert(seen[0], angles[0], speed))
            expected = _forces(model, believed, angles, speed, found)
            mass[row, i] = np.log(found / flow[i]) / step
            ratios[:, row, i] = np.log((expected / seen)[1:]) / step
    return Sensitivities(mass, ratios)


def _forces(model: ForwardModel, values: dict[str, float], angles: Array, speed: float, flow: float) -> Array:
    return np.real(
        model.force(Conditions(angles, np.full(angles.shape, speed), mass_flow_kg_s=np.full(angles.shape, flow)), values)
    )


def prior_of(first: ParameterSet, kept: StudySettings) -> Array:
    """Covariance of the state at the season's start: calibration, slopes, and drift of either sign and the season's size."""
    scale = np.array([first.values[name] + (1.0 if name == "restitution" else 0.0) for name in GRAIN])
    prior = np.zeros((9, 9))
    prior[:3, :3] = first.covariance_of(GRAIN) / np.outer(scale, scale)
    prior[3:6, 3:6] = np.diag([kept.map_sd[f"{name}_per_pct"] ** 2 for name in GRAIN])
    prior[6:, 6:] = np.eye(3)
    return prior


def tickets_at(days: NDArray[np.int64], tickets: int) -> NDArray[np.bool_]:
    """Loads with a ticket: of each day so many, evenly, the last one that of its evening."""
    found = np.zeros(days.size, dtype=bool)
    for day in np.unique(days):
        loads = np.flatnonzero(days == day)
        # The load that ends a day goes on into the next one, so that it is the first of that.
        found[loads[np.arange(tickets) * loads.size // tickets]] = True
    found[0] = False
    return found


@dataclass(frozen=True)
class _Told:
    """Readings row @ state of some loads, (loads, 9) and (loads,), of one relative standard deviation."""

    rows: Array
    sd: float
    at: NDArray[np.bool_]


def _sd(
    rows: Array, told: Sequence[_Told], prior: Array, weighed: NDArray[np.bool_], ticket_sd: Array, days: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Relative standard deviation of each load's mass, but for its own zero and noise: before a ticket for it, and as posted by
    all tickets until `POSTED_DAYS` later."""
    covariance, live, after = prior, np.empty(len(rows)), []
    for i, row in enumerate(rows):
        for reading in told:
            if reading.at[i]:
                covariance = _read(covariance, reading.rows[i], reading.sd)
        live[i] = np.sqrt(max(row @ covariance @ row, 1e-12))
        if weighed[i]:
            covariance = _read(covariance, row, float(ticket_sd[i]))
        after.append(covariance)
    until = np.minimum(np.searchsorted(days, days + POSTED_DAYS), len(rows) - 1)
    # Nothing of the state changes with time, so that what later readings leave of it holds for all loads.
    posted = np.array([np.sqrt(max(row @ after[k] @ row, 1e-12)) for row, k in zip(rows, until, strict=True)])
    return live, posted


def _errors(
    rows: Array, told: Sequence[_Told], prior: Array, weighed: NDArray[np.bool_], ticket_sd: Array, own_sd: Array
) -> Array:
    """Relative live error of each load in seasons drawn, (seasons, loads); the same seasons whatever is told."""
    rng = np.random.default_rng(0)
    true = rng.multivariate_normal(np.zeros(len(prior)), prior, _SEASONS)
    own, of_tickets = (sd * rng.standard_normal((_SEASONS, len(rows))) for sd in (own_sd, ticket_sd))
    found, covariance, errors = np.zeros_like(true), prior, np.empty((_SEASONS, len(rows)))
    for i, row in enumerate(rows):
        for reading in told:
            if reading.at[i]:
                noise = reading.sd * rng.standard_normal(_SEASONS)
                found = found + np.outer((true - found) @ reading.rows[i] + noise, _gain(covariance, reading.rows[i], reading.sd))
                covariance = _read(covariance, reading.rows[i], reading.sd)
        errors[:, i] = (found - true) @ row + own[:, i]
        if weighed[i]:
            sd = float(ticket_sd[i])
            found = found + np.outer((true - found) @ row + of_tickets[:, i], _gain(covariance, row, sd))
            covariance = _read(covariance, row, sd)
    return errors


def _gain(covariance: Array, row: Array, sd: float) -> Array:
    tie = covariance @ row
    return np.asarray(tie / (row @ tie + sd**2))


def _read(covariance: Array, row: Array, sd: float) -> Array:
    gain = _gain(covariance, row, sd)
    left = np.eye(len(row)) - np.outer(gain, row)
    return np.asarray(left @ covariance @ left.T + sd**2 * np.outer(gain, gain))
