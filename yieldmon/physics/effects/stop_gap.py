"""What a calibration saw the model miss, as a smooth relative error over plate angle and load with weights of its own."""

from __future__ import annotations

from dataclasses import replace
from math import degrees

import numpy as np

from yieldmon.physics.numerics import AnyArray, maximum, minimum, real, sqrt
from yieldmon.physics.stages import Reading, Setting

from .effect import Effect, EffectParameter, Values

POWERS = tuple((i, j) for i in range(4) for j in range(4) if i + j <= 4)
"""Degrees in plate angle and in the root of the load of each weight's Legendre polynomials."""
_FADE = 0.3
"""Of half the calibrated range: so far beyond its ends the correction has faded to nothing."""


def weight_name(angle: int, load: int) -> str:
    """Name of the weight of these degrees."""
    return f"w{angle}{load}"


def _axis(value: AnyArray, low: AnyArray, high: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Place in the calibrated range, -1 to 1 and held at its ends, and how far it is left, 0 inside to 1."""
    span = high - low
    span = np.where(real(span) > 0.0, span, 1.0)
    at = (2.0 * value - low - high) / span
    size = maximum(at, -at)
    left = minimum(maximum((size - 1.0) / _FADE, np.zeros(1)), np.ones(1))
    return minimum(maximum(at, np.full(1, -1.0)), np.ones(1)), left * left * (3.0 - 2.0 * left)


def _legendre(at: AnyArray) -> tuple[AnyArray, ...]:
    square = at * at
    return np.ones(1), at, 1.5 * square - 0.5, (2.5 * square - 1.5) * at


def _reading(reading: Reading, values: Values, setting: Setting) -> Reading:
    load = sqrt(maximum(reading.impulse.arrival.jet.load.paddle_mass_kg, np.zeros(1)))
    angle, beyond_angle = _axis(setting.plate_angle_rad * degrees(1.0), values["lowest_angle_deg"], values["highest_angle_deg"])
    place, beyond_load = _axis(load, sqrt(values["lowest_load_kg"]), sqrt(values["highest_load_kg"]))
    by_angle, by_load = _legendre(angle), _legendre(place)
    error: AnyArray = np.zeros(1)
    for i, j in POWERS:
        error = error + values[weight_name(i, j)] / (1.0 + i + j) * by_angle[i] * by_load[j]
    error = error * (1.0 - beyond_angle) * (1.0 - beyond_load)
    error = error + values["beyond_angle"] * beyond_angle + values["beyond_load"] * beyond_load
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s * (1.0 + error))


def _weight(name: str, what: str) -> EffectParameter:
    return EffectParameter(name, "", 0.0, -0.8, 0.8, 0.05, what, 0.01)


EFFECT = Effect(
    name="stop_gap",
    stage="sensor",
    summary="The reading differs from the model's by a smooth error of no named cause, as a calibration saw it.",
    signature="whatever a calibration leaves, smooth over plate angle and load; nothing beyond the calibrated range, where its "
    "uncertainty grows instead",
    source="Kennedy and O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. B 63 (2001)",
    parameters=(
        *(_weight(weight_name(i, j), f"relative error of degree {i} in plate angle, {j} in root load") for i, j in POWERS),
        _weight("beyond_angle", "relative error beyond the calibrated angles"),
        _weight("beyond_load", "relative error beyond the calibrated loads"),
        EffectParameter("lowest_angle_deg", "deg", 0.0, 0.0, 180.0, 1.0, "lowest calibrated plate angle", 50.0),
        EffectParameter("highest_angle_deg", "deg", 0.0, 0.0, 180.0, 1.0, "highest calibrated plate angle", 90.0),
        EffectParameter("lowest_load_kg", "kg", 0.0, 0.0, 20.0, 0.01, "lowest calibrated paddle load", 0.2),
        EffectParameter("highest_load_kg", "kg", 0.0, 0.0, 20.0, 0.01, "highest calibrated paddle load", 2.0),
    ),
    reading=_reading,
    measured=True,
    rank=4,
)
