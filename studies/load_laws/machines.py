"""Machines whose force follows laws of their own, and their weighed loads. Only the laws named after the model come from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from yieldmon import api
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.physics.numerics import Array

MACHINE = api.Machine()
SHIPPED = api.load_parameters()
ANGLE_RAD = MACHINE.home_plate_angle_rad
SPEED_RAD_S = MACHINE.nominal_elevator_speed_rad_s
_AT_KG_S = 10.0
"""Flow at which a machine's gain is given."""
Law = Callable[[Array], Array]


def _power(exponent: float, flow_kg_s: Array) -> Array:
    return np.asarray((flow_kg_s / _AT_KG_S) ** exponent)


def _saturating(at_kg_s: float, flow_kg_s: Array) -> Array:
    return np.asarray(np.expm1(-flow_kg_s / at_kg_s) / np.expm1(-_AT_KG_S / at_kg_s))


def _logarithmic(flow_kg_s: Array) -> Array:
    return np.asarray(np.log1p(flow_kg_s / 4.0) / np.log1p(_AT_KG_S / 4.0))


def _quadratic(flow_kg_s: Array) -> Array:
    return np.asarray((flow_kg_s / _AT_KG_S + 0.3 * (flow_kg_s / _AT_KG_S) ** 2) / 1.3)


def _with_offset(flow_kg_s: Array) -> Array:
    return np.asarray((_power(0.8, flow_kg_s) + 0.04) / 1.04)


#: Force over flow (kg/s), 1 at _AT_KG_S.
LAWS: Mapping[str, Law] = {
    **{f"power {exponent}": partial(_power, exponent) for exponent in (0.7, 0.8, 0.9, 1.0, 1.15, 1.3)},
    **{f"saturating {at_kg_s:g} kg/s": partial(_saturating, at_kg_s) for at_kg_s in (12.0, 25.0)},
    "logarithmic": _logarithmic,
    "quadratic": _quadratic,
    "power 0.8, offset 4 %": _with_offset,
}
#: Density over the shipped corn's, of machines whose force is the model's.
MODELS = {"model": 1.0, "model, density -18 %": 0.82, "model, density +18 %": 1.18}
FLOWS_KG_S = ((3.5, 6.0), (9.0, 13.0), (16.0, 21.0), (5.0, 9.0), (12.0, 17.0), (17.0, 20.0))
"""Ranges of the weighed loads' mean flows; the first three come in any order."""
FURTHER_KG_S = np.linspace(3.5, 20.0, 10)
FURTHER_KG = 3000.0
TICKET_SD = 0.003
SCATTER, ZERO_N = 0.03, 0.1
"""Of a second's force, relative; and of the zero, which wanders over ten minutes."""


@dataclass(frozen=True)
class Drawn:
    """weighed: six loads in order. further: ten more, with their true masses in kg."""

    weighed: tuple[WeighedLoad, ...]
    further: tuple[tuple[WeighedLoad, float], ...]


def draw(name: str, seed: int) -> Drawn:
    """A machine of a law: its gain (60 to 115 N at 10 kg/s) and how its force goes with the elevator's speed are drawn.

    Parameters
    ----------
    name : str
        In LAWS or MODELS.
    seed : int
    """
    random = np.random.default_rng([seed, *name.encode()])
    gain_n, by_speed = random.uniform(60.0, 115.0), random.uniform(0.6, 1.3)
    law = LAWS.get(name)

    def force_n(flow_kg_s: Array, speed_rad_s: Array) -> Array:
        if law is None:
            return _by_model(MODELS[name], flow_kg_s, speed_rad_s) * gain_n / 80.0
        return np.asarray(gain_n * law(flow_kg_s) * (speed_rad_s / SPEED_RAD_S) ** by_speed)

    order = (*random.permutation(3).tolist(), 3, 4, 5)
    weighed = tuple(
        _harvest(force_n, random, str(k), random.uniform(*FLOWS_KG_S[i]), random.uniform(2000.0, 9000.0))[0]
        for k, i in enumerate(order, 1)
    )
    return Drawn(weighed, tuple(_harvest(force_n, random, "further", flow, FURTHER_KG) for flow in FURTHER_KG_S))


def _by_model(density: float, flow_kg_s: Array, speed_rad_s: Array) -> Array:
    values = dict(SHIPPED.values) | {"density": SHIPPED.values["density"] * density, "restitution": 0.45}
    at = api.Conditions(np.full(flow_kg_s.shape, ANGLE_RAD), speed_rad_s, mass_flow_kg_s=flow_kg_s)
    return np.real(api.ForwardModel(MACHINE, SHIPPED.effects).force(at, values))


def _harvest(
    force_n: Callable[[Array, Array], Array], random: np.random.Generator, name: str, mean_kg_s: float, mass_kg: float
) -> tuple[WeighedLoad, float]:
    seconds = max(int(mass_kg / mean_kg_s), 60)
    flow = np.clip(mean_kg_s * (1.0 + 0.22 * _wandering(seconds, 40.0, random)), 0.35 * mean_kg_s, 1.6 * mean_kg_s)
    speed = SPEED_RAD_S * (1.0 - 0.03 * flow / 25.0) * (1.0 + 0.003 * _wandering(seconds, 5.0, random))
    speed = speed * (1.0 + 0.01 * random.standard_normal())
    force = force_n(flow, speed) * (1.0 + SCATTER * random.standard_normal(seconds)) + ZERO_N * _wandering(seconds, 600.0, random)
    true_kg = float(flow.sum())
    ticket_kg = true_kg * (1.0 + TICKET_SD * random.standard_normal())
    noise = 1.2 * SCATTER / np.sqrt(seconds)
    angle = np.full(seconds, ANGLE_RAD)
    return WeighedLoad(name, ticket_kg, TICKET_SD * true_kg, np.ones(seconds), force, angle, speed, noise_sd=noise), true_kg


def _wandering(count: int, time_s: float, random: np.random.Generator) -> Array:
    """A first-order autoregression of standard deviation 1."""
    keep = np.exp(-1.0 / time_s)
    values = random.standard_normal(count)
    for i in range(1, count):
        values[i] = keep * values[i - 1] + np.sqrt(1.0 - keep**2) * values[i]
    return values


def judged(known: ParameterSet, drawn: Drawn) -> Array:
    """(10, 2) error of each further load and its standard deviation, %, with these parameters.

    The flow's own deviation counts as common to a load; the zero's and the scale's 0.2 % and the windows' scatter come beside it.
    """
    loop = api.OpenLoop(api.ForwardModel(MACHINE, known.effects), known)
    rows = []
    for load, true_kg in drawn.further:
        found = loop.estimate(load.force_n, load.plate_angle_rad, load.elevator_speed_rad_s)
        measured_kg = float(found.mass_flow_kg_s.sum())
        std_dev = np.sqrt((float(found.std_dev_kg_s.sum()) / measured_kg) ** 2 + 0.002**2 + load.noise_sd**2)
        rows.append((100.0 * (measured_kg / true_kg - 1.0), 100.0 * std_dev))
    return np.array(rows)
