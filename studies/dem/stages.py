"""Sizes of the effects that the grains' records show, learnt from one crop stage by stage, and the error that each stage leaves.

Release and flight are learnt from the momentum that crosses the plate's plane on, over and below the plate; impact from the
impulses, with release and flight held.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import radians, sqrt, tan

import numpy as np
from scipy.optimize import least_squares

from studies.dem.job import Grain
from studies.dem.script import PLATE_THICKNESS_M
from yieldmon.physics.effects import effect_parameter
from yieldmon.physics.effects.edges import KERNEL_M, share_beyond
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

Rows = dict[str, np.ndarray]
Sizes = dict[str, float]

MACHINE = Machine()
#: What is known without a throw: gravity, and the plate's end, to which a grain's centre comes no nearer than its radius.
KNOWN: Sizes = {"gravity.acceleration_m_s2": 9.81, "top_edge.thickness_m": PLATE_THICKNESS_M + Grain().radius_m}
RELEASE = ("gravity", "stream_rise", "unpushed_layers")
IMPACT = ("jet_shielding", "miss_capture", "top_edge")
FRICTION = "plate_friction"
ARRIVAL_COLUMNS = ("on_plate_kg_m_s", "over_top_kg_m_s", "below_low_kg_m_s")
LOWEST_ANGLE_DEG = 40.0


def conditions(rows: Rows) -> Conditions:
    """Settings and loads of a campaign's rows, SI."""
    return Conditions(
        np.radians(rows["plate_angle_deg"]), rows["elevator_speed_rpm"] * RPM, paddle_mass_kg=rows["paddle_mass_kg"]
    )


def crossing_momentum(values: Sizes, rows: Rows) -> np.ndarray:
    """Normal momentum on, over and below the plate by the model, kg m/s, shape (rows, 3), as `records.arrival` counts it."""
    at = conditions(rows)
    throw = ForwardModel(MACHINE, RELEASE).throw(at.plate_angle_rad, at.elevator_speed_rad_s, {"k1": 0.0, "k2": 1.0} | values)
    arrival = throw.reading(rows["paddle_mass_kg"]).impulse.arrival
    meets = np.isfinite(arrival.from_low_edge_m)
    momentum = np.where(meets, arrival.jet.mass_kg * np.where(meets, arrival.normal_speed_m_s, 0.0), 0.0)
    above_m = -np.where(meets, arrival.from_low_edge_m, 0.0) - MACHINE.plate_length_m
    on = np.sum(momentum * arrival.landing_share, axis=-1)
    over = np.sum(momentum * share_beyond(above_m, np.asarray(KERNEL_M)), axis=-1)
    return np.stack((on, over, momentum.sum(axis=-1) - on - over), axis=-1)


def _learn(names: tuple[str, ...], start: Sizes, residual: Callable[[Sizes], np.ndarray]) -> Sizes:
    """Least squares from typical values, within the effects' own bounds."""
    limits = {"k1": (-20.0, 20.0), "k2": (-5.0, 20.0)}
    for name in names:
        if name not in limits:
            parameter = effect_parameter(name)
            limits[name] = (parameter.lower, parameter.upper)

    def residuals(x: np.ndarray) -> np.ndarray:
        return residual(dict(zip(names, x, strict=True)))

    found = least_squares(
        residuals,
        [start[n] for n in names],
        diff_step=[1e-4] * len(names),
        bounds=([limits[n][0] for n in names], [limits[n][1] for n in names]),
        x_scale=[max(abs(start[n]), 0.1) for n in names],
    )
    return {name: float(x) for name, x in zip(names, found.x, strict=True)}


def typical(names: tuple[str, ...]) -> Sizes:
    """Sizes at which the effects matter, for a search to start from."""
    return {name: effect_parameter(name).typical for name in names}


def learn_release(grain: Sizes, rows: Rows, arrivals: Rows) -> Sizes:
    """stream_rise and unpushed_layers from where the stream crosses the plate's plane, at equal errors relative to the whole."""
    names = ("stream_rise.ratio", "unpushed_layers.rate_per_rad")
    recorded = np.column_stack([arrivals[column] for column in ARRIVAL_COLUMNS])
    whole = recorded.sum(axis=1, keepdims=True)
    return _learn(names, typical(names), lambda x: ((crossing_momentum(grain | KNOWN | x, rows) - recorded) / whole).ravel())


def learn_impact(grain: Sizes, rows: Rows, release: Sizes) -> Sizes:
    """Sizes of the effects on impact from both readings at once, at equal relative errors; the gain k1, k2 is not carried on."""
    names = ("jet_shielding.rate_per_m", "miss_capture.share", f"{FRICTION}.coefficient")
    smooth, rough = ForwardModel(MACHINE, (*RELEASE, *IMPACT)), ForwardModel(MACHINE, (*RELEASE, *IMPACT, FRICTION))
    at, held = conditions(rows), {**grain, **KNOWN, **release}

    def residual(x: Sizes) -> np.ndarray:
        total = rough.paddle_momentum(at, held | x) / rows["momentum_total_kg_m_s"]
        without = {name: value for name, value in x.items() if not name.startswith(FRICTION)}
        normal = smooth.paddle_momentum(at, held | without) / rows["momentum_kg_m_s"]
        return np.concatenate((normal, total)) - 1.0

    found = _learn(("k1", "k2", *names), {"k1": 0.0, "k2": 1.3, **typical(names)}, residual)
    return {name: found[name] for name in names}


def friction_on_plate(coefficient: float, learnt_at: float, used_at: float) -> float:
    """The plate's coefficient for grain of another friction.

    It goes with the grain's own where grain slides, and no further than to rolling, 2/7 of the tangential speed, met half way
    between (in squares) at the lowest plate angle, where friction matters most.
    """
    rolling = 2.0 / 7.0 / tan(radians(LOWEST_ANGLE_DEG))
    slides = [friction / sqrt(1.0 + (friction / rolling) ** 2) for friction in (learnt_at, used_at)]
    return coefficient * slides[1] / slides[0]


def budget_pct(values: Sizes, rows: Rows, arrivals: Rows) -> Mapping[str, np.ndarray]:
    """Error of the normal-only reading at the recorded load, % of it, parted into what each stage adds.

    values: grain, k1, k2 and the sizes of all effects but plate_friction. `stream`: what lands on the face differs from the
    records; `end`: the plate's end takes another impulse; `gain`: impulse on the face per momentum that lands there, grain caught
    past the edges included. The parts add up to `whole`.
    """
    at = conditions(rows)
    throw = ForwardModel(MACHINE, (*RELEASE, *IMPACT)).throw(at.plate_angle_rad, at.elevator_speed_rad_s, values)
    reading = throw.reading(rows["paddle_mass_kg"])
    impulse, arrival = reading.impulse, reading.impulse.arrival
    landed = arrival.landing_share * arrival.jet.mass_kg
    taken = np.where(landed > 0.0, landed * impulse.normal_gain * np.where(landed > 0.0, arrival.normal_speed_m_s, 0.0), 0.0)
    # top_edge gives the nodes of the face first, then those of the end, whose speed is already turned.
    face, end = (part.sum(axis=-1) * np.sin(at.plate_angle_rad) for part in np.split(taken, 2, axis=-1))
    recorded = rows["momentum_kg_m_s"]
    on_face = arrivals["on_face_kg_m_s"] * np.sin(at.plate_angle_rad)
    on_end = arrivals["on_end_kg_m_s"] * np.cos(at.plate_angle_rad)
    lands = crossing_momentum(values, rows)[:, 0] / arrivals["on_plate_kg_m_s"]
    parts = {"stream": on_face * (lands - 1.0), "gain": face - on_face * lands, "end": end - on_end}
    whole = reading.momentum_kg_m_s[..., 0] - recorded
    return {name: 100.0 * part / recorded for name, part in {**parts, "whole": whole}.items()}
