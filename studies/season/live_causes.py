"""What a season's live error is made of: each load measured again with one thing as it truly is.

A ticket a day, no sweeps, at the daemon's defaults. What the parameters say of a load is replaced by what is true of it, one by
one and together; zero, noise and moisture likewise. Parameters make up for each other (a ticket fixes one combination of them at
its own flow), so that one alone put right may leave more error than none. So the error is split another way as well: what loads
near each other in time share is the scale's, what of the rest goes with the flow is that of friction and fill, and what is left
is each load's own.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from studies.season import study
from studies.season.season import Season
from studies.season.study import Array, Keeper, StudySettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.effects.moisture_dependence import REFERENCE_PCT
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import ForwardModel

GRAIN = ("friction", "restitution", "density")
EFFECT = "moisture_dependence"
NEAR_LOADS = 8
"""Loads before and after one whose shared error is the scale's: a quarter of a day on either side."""
PUT_RIGHT: dict[str, tuple[str, ...]] = {
    "as measured": (),
    "zero and noise": ("zero", "noise"),
    "moisture reading": ("moisture",),
    "friction": ("friction",),
    "gain": ("restitution",),
    "fill (density, wear)": ("density", "wear"),
    "friction and fill": ("friction", "density", "wear"),
    "gain and fill": ("restitution", "density", "wear"),
    "gain and friction": ("restitution", "friction"),
    "grain and wear": (*GRAIN, "wear"),
    "grain, wear, zero and noise": (*GRAIN, "wear", "zero", "noise"),
}


def live_causes(season: Season, first: ParameterSet, kept: StudySettings) -> dict[str, Any]:
    """Mean absolute error (%) and share within 1 % of the season's loads live, by what is put right."""
    strategy = study.Strategy("map and ticket", moisture_map=True, tickets_per_day=1)
    keeper = Keeper(season, first, strategy, kept)
    believed: list[ParameterSet] = []
    for number in range(season.loads.start.size):
        believed.append(keeper.parameters)
        keeper.harvest(number)
    found: dict[str, Any] = {}
    error_pct = np.zeros(0)
    for label, right in PUT_RIGHT.items():
        mass = np.array([_mass_kg(season, number, believed[number], right) for number in range(len(believed))])
        errors = 100.0 * (mass / season.loads.mass_kg - 1.0)
        error_pct = errors if not right else error_pct
        found[label] = _said(errors)
    shared, by_flow = _shared(season, error_pct)
    found |= {
        "scale of loads near": _said(error_pct - shared),
        "and its change with the flow": _said(error_pct - shared - by_flow),
        "only the scale of loads near wrong": _said(shared),
    }
    return found


def _said(errors_pct: Array) -> dict[str, float]:
    return {
        "mean_abs_pct": round(float(np.mean(np.abs(errors_pct))), 3),
        "within_1_pct": round(float(np.mean(np.abs(errors_pct) <= 1.0)), 3),
    }


def _mass_kg(season: Season, number: int, believed: ParameterSet, right: tuple[str, ...]) -> float:
    """A load by what was believed, but for what is put right."""
    windows = np.arange(season.loads.start[number], season.loads.end[number])
    windows = windows[season.mass_flow_kg_s[windows] > 0.0]
    machine = season.machine
    force, sigma = season.measure(windows, float(np.degrees(machine.home_plate_angle_rad)))
    if "noise" in right:
        force = force - sigma * season.noise[windows]
    if "zero" in right:
        force = force - season.zero_error_n[windows]
    reading = season.moisture_pct if "moisture" in right else season.moisture_reading_pct
    wetter = float(np.mean(reading[windows])) - REFERENCE_PCT
    true = {"friction": season.friction, "restitution": season.restitution, "density": season.density_kg_m3}
    values = {name: value for name, value in believed.values.items() if not name.startswith(EFFECT)}
    for name in GRAIN:
        values[name] *= float(np.exp(believed.values[f"{EFFECT}.{name}_per_pct"] * wetter))
        if name in right:
            values[name] = float(np.mean(true[name][windows]))
    if "wear" in right:
        machine = replace(machine, paddle_length_m=float(np.mean(season.paddle_length_m[windows])))
    model = ForwardModel(machine, [name for name in believed.effects if name != EFFECT])
    loop = OpenLoop(model, ParameterSet(values))
    speed = season.elevator_speed_rpm[windows] * RPM
    return float(np.sum(study.inverted(loop, np.maximum(force, 0.0), machine.home_plate_angle_rad, speed, None)))


def _shared(season: Season, error_pct: Array) -> tuple[Array, Array]:
    """Of each load's error the part that loads near it share, and of the rest that which goes with the logarithm of the flow."""
    flow = season.loads.mass_kg / np.add.reduceat((season.mass_flow_kg_s > 0.0).astype(float), season.loads.start)
    shared, by_flow = np.empty(error_pct.size), np.empty(error_pct.size)
    for i in range(error_pct.size):
        near = slice(max(i - NEAR_LOADS, 0), i + NEAR_LOADS + 1)
        log_flow = np.log(flow[near])
        slope, level = np.polyfit(log_flow - log_flow.mean(), error_pct[near], 1)
        shared[i], by_flow[i] = level, slope * (np.log(flow[i]) - log_flow.mean())
    return shared, by_flow
