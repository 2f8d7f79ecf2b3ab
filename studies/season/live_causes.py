"""What a season's live error is made of: each load measured again with one thing as it truly is.

A ticket a day, no sweeps, at the daemon's defaults. What the parameters say of a load is replaced by what is true of it, one by
one and together; zero, noise and moisture likewise. Parameters make up for each other (a ticket fixes one combination of them at
its own flow), so that one alone put right may leave more error than none. So the error is split another way as well: what loads
near each other in time share is the scale's, what of the rest goes with the flow is that of friction and fill, and what is left
is each load's own.

A third way (`live_parts`) is by time: of the parameters' error, by the load's sensitivities to it, what it was right after the
last ticket at that ticket's own flow, what it makes of another flow than that, and what has come since.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from studies.season import study
from studies.season.best_live import GRAIN, sensitivities
from studies.season.season import Season
from studies.season.study import Array, Keeper, StudySettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.effects.moisture_dependence import REFERENCE_PCT
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import ForwardModel

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


def live_parts(season: Season, first: ParameterSet, kept: StudySettings, *, sweeps: bool = False) -> dict[str, Any]:
    """Of the live errors with a ticket a day, by part: rms (%), and mean absolute error and share within 1 % without it.

    Parts: scale (right after the last ticket, at its own flow), curve (the same at the load's flow), drift (of the parameters in
    use against the true ones since then), zero and noise, model (what is left with all of these right). For a combine whose grain
    is the model's. Before the first ticket the scale is that of the calibration.
    """
    keeper = Keeper(season, first, study.Strategy("", moisture_map=True, sweeps=sweeps, tickets_per_day=1), kept)
    of = sensitivities(season).mass
    parts = np.zeros((5, season.loads.start.size))
    weighed: tuple[Array, Array | None] = (_off(season, 0, keeper.parameters), None)
    for number in range(parts.shape[1]):
        believed, told, here = keeper.parameters, keeper.told_day, of[:, number]
        off, (then, at_ticket) = _off(season, number, believed), weighed
        there = here if at_ticket is None else at_ticket
        parts[:3, number] = there @ then, (here - there) @ then, here @ (off - then)
        measured, without = (_mass_kg(season, number, believed, right) for right in ((), ("zero", "noise")))
        parts[3, number] = np.log(measured / without)
        parts[4, number] = np.log(without / season.loads.mass_kg[number]) - np.sum(parts[:3, number])
        keeper.harvest(number)
        if keeper.told_day > told:
            weighed = _off(season, number, keeper.parameters), here
    parts *= 100.0
    total = np.sum(parts, axis=0)
    found: dict[str, Any] = {"all": _said(total) | {"rms_pct": round(float(np.sqrt(np.mean(total**2))), 3)}}
    for label, part in zip(("scale", "curve", "drift", "zero and noise", "model"), parts, strict=True):
        found[label] = _said(total - part) | {"rms_pct": round(float(np.sqrt(np.mean(part**2))), 3)}
    found["scale and drift"] = _said(total - parts[0] - parts[2])
    found["all but drift"] = _said(parts[2])
    return found


def _off(season: Season, number: int, believed: ParameterSet) -> Array:
    """Of a load, (4,): ln of friction, 1 + restitution and density as believed over the true ones, and unknown wear, mm."""
    windows = slice(int(season.loads.start[number]), int(season.loads.end[number]))
    wetter = float(np.mean(season.moisture_reading_pct[windows])) - REFERENCE_PCT
    true = {"friction": season.friction, "restitution": season.restitution, "density": season.density_kg_m3}
    found = []
    for name in GRAIN:
        value = believed.values[name] * float(np.exp(believed.values[f"{EFFECT}.{name}_per_pct"] * wetter))
        more = 1.0 if name == "restitution" else 0.0
        found.append(float(np.log((value + more) / (np.mean(true[name][windows]) + more))))
    wear_m = season.machine.paddle_length_m - float(np.mean(season.paddle_length_m[windows]))
    return np.array([*found, 1e3 * wear_m])


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
