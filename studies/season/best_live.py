"""The most that any estimator can have right live with one ticket a day, if it knows how the season drifts but not by how much.

A Kalman filter with the season's own drift: friction, restitution and wear move at steady rates, the moisture map's slopes are
off by constants. Rates are drawn with the deviation that the season's drift has, slopes and the calibration with those stated;
there is no random walk. Linear in the logarithm of a load's mass, so that the deviations do not depend on what was measured.
Without sweeps, and with sweeps that tell friction exactly with every load. What sweeps say of the paddles' fill is left out:
over the plate angle it looks like friction.
"""

from __future__ import annotations

from dataclasses import replace
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
_KNOWN = 1e-4
"""Relative standard deviation of what a perfect sweep tells."""
_STEP = 0.01


def best_live(season: Season, first: ParameterSet, harvest: SeasonSettings, kept: StudySettings) -> dict[str, Any]:
    """Expected shares of the loads within 1 % live, 0 to 1, by what sweeps tell; also by days.

    first: the calibration at the season's start. kept: what its map's slopes and tickets are known to, and the length of a day.
    """
    loads = season.loads
    middle = (loads.start + loads.end) // 2
    moisture = np.array([np.mean(season.moisture_pct[a:b]) for a, b in zip(loads.start, loads.end, strict=True)])
    progress = season.time_s[middle] / (3600.0 * harvest.hours)
    by_grain, by_wear = _sensitivities(season, middle, moisture)
    # State: ln friction, ln (1 + e), ln density at the start; the map's slopes; friction's, (1 + e)'s and the wear's share of
    # the season's drift.
    gain = season.restitution[middle] / (1.0 + season.restitution[middle])
    wetter = moisture - REFERENCE_PCT
    along = np.zeros((3, middle.size, 9))
    for row, (own, slope) in enumerate(((1.0, 1.0), (1.0, gain), (1.0, 1.0))):
        along[row, :, row] = own
        along[row, :, 3 + row] = slope * wetter
    along[0, :, 6] = harvest.friction_drift * progress
    along[1, :, 7] = harvest.restitution_drift * progress * gain
    rows = np.einsum("gl,gls->ls", by_grain, along)
    rows[:, 8] += by_wear * harvest.wear_mm * progress
    prior = _prior(first, kept)
    days = (season.time_s[loads.end - 1] // kept.day_s).astype(int)
    found: dict[str, Any] = {}
    ticket_sd = float(np.hypot(kept.ticket_sd_kg / np.mean(loads.mass_kg), kept.anchor_error))
    for label, told in (("no sweeps", None), ("friction known", along[0])):
        sd = _live_sd(rows, told, prior, days, ticket_sd)
        share = erf(0.01 / (np.sqrt(2.0) * sd))
        found[label] = round(float(np.mean(share)), 3)
        found[f"{label}, by day"] = [round(float(np.mean(share[days == day])), 2) for day in range(int(days[-2]) + 1)]
    return found


def _sensitivities(season: Season, middle: NDArray[np.int64], moisture: Array) -> tuple[Array, Array]:
    """Change of a load's ln(mass) with what is believed: by ln of friction, 1 + restitution, density (3, loads), and by mm of
    wear (loads,) that the machine has and the model does not know."""
    machine = season.machine
    flow = np.array([np.mean(season.mass_flow_kg_s[a:b]) for a, b in zip(season.loads.start, season.loads.end, strict=True)])
    speed = season.elevator_speed_rpm[middle] * RPM
    model = ForwardModel(machine, ("gravity",))
    worn = ForwardModel(replace(machine, paddle_length_m=machine.paddle_length_m - 1e-3), ("gravity",))
    angle = machine.home_plate_angle_rad
    grain, wear = np.empty((3, middle.size)), np.empty(middle.size)
    for i, window in enumerate(middle):
        values = {
            "friction": float(season.friction[window]),
            "restitution": float(season.restitution[window]),
            "density": float(season.density_kg_m3[window]),
            "shape_ratio": 2.0,
            "gravity.acceleration_m_s2": 9.81,
        }
        conditions = Conditions(angle, speed[i], mass_flow_kg_s=flow[i])
        force = float(np.real(model.force(conditions, values)))
        known = ParameterSet(values)
        for row, name in enumerate(GRAIN):
            offset = 1.0 if name == "restitution" else 0.0
            moved = replace(known, values={**values, name: (values[name] + offset) * (1.0 + _STEP) - offset})
            grain[row, i] = np.log(float(OpenLoop(model, moved).invert(force, angle, speed[i])) / flow[i]) / _STEP
        less = float(np.real(worn.force(conditions, values)))
        wear[i] = np.log(float(OpenLoop(model, known).invert(less, angle, speed[i])) / flow[i])
    return grain, wear


def _prior(first: ParameterSet, kept: StudySettings) -> Array:
    """Covariance of the state at the season's start: calibration, slopes, and drift of either sign and the season's size."""
    scale = np.array([first.values[name] + (1.0 if name == "restitution" else 0.0) for name in GRAIN])
    prior = np.zeros((9, 9))
    prior[:3, :3] = first.covariance_of(GRAIN) / np.outer(scale, scale)
    prior[3:6, 3:6] = np.diag([kept.map_sd[f"{name}_per_pct"] ** 2 for name in GRAIN])
    prior[6:, 6:] = np.eye(3)
    return prior


def _live_sd(rows: Array, told: Array | None, prior: Array, days: Array, ticket_sd: float) -> Array:
    """Relative standard deviation of each load's mass before the ticket that follows it: the last load of each day."""
    covariance, sd = prior, np.empty(len(rows))
    for i, row in enumerate(rows):
        if told is not None:
            covariance = _read(covariance, told[i], _KNOWN)
        sd[i] = np.sqrt(max(row @ covariance @ row, 1e-12))
        if i > 0 and days[i] > days[i - 1]:
            # The load that ends a day goes on into the next one.
            covariance = _read(covariance, row, ticket_sd)
    return sd


def _read(covariance: Array, row: Array, sd: float) -> Array:
    tie = covariance @ row
    gain = tie / (row @ tie + sd**2)
    left = np.eye(len(row)) - np.outer(gain, row)
    return np.asarray(left @ covariance @ left.T + sd**2 * np.outer(gain, gain))
