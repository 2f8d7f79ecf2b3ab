"""What the model misses of a machine's force over load and speed, as a smooth pattern with weights of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import AnyArray, sqrt
from yieldmon.physics.stages import Reading, Setting

from .effect import Effect, EffectParameter, Values

_REFERENCE_KG_M3 = 150.0
"""Grain on a paddle, over width times length squared, at which the pattern is 1: about 10 kg/s at 400 rpm."""
_LEAST = 0.05
"""Share of that load below which the force follows the load as in the model."""


def reference_load_kg(machine: Machine) -> float:
    """Grain on a paddle at which the pattern is 1, kg."""
    return float(_reference_kg(machine.paddle_width_m, np.asarray(machine.paddle_length_m)))


def _reference_kg(width_m: float, length_m: AnyArray) -> AnyArray:
    reference: AnyArray = _REFERENCE_KG_M3 * width_m * length_m**2
    return reference


def _reading(reading: Reading, values: Values, setting: Setting) -> Reading:
    reference_kg = _reference_kg(setting.machine.paddle_width_m, setting.paddle_length_m)
    share = reading.impulse.arrival.jet.load.paddle_mass_kg / reference_kg
    log_load: AnyArray = 0.5 * np.log(share * share + _LEAST**2)
    bend = sqrt(1.0 + log_load * log_load) - 1.0
    log_speed = np.log(setting.speed_ratio)
    pattern: AnyArray = values["exponent"] * log_load + values["bend"] * bend + values["speed"] * log_speed
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s * np.exp(pattern))


EFFECT = Effect(
    name="load_pattern",
    stage="sensor",
    summary="The reading follows another curve over load and speed than the model's, of no named cause.",
    signature="a factor over load and speed alone, at every plate angle; what weighed loads repeat and no parameter explains",
    source="Kennedy and O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. B 63 (2001)",
    parameters=(
        EffectParameter("exponent", "", 0.0, -0.8, 1.2, 0.2, "power of the load beside the model's curve", 0.1),
        EffectParameter("bend", "", 0.0, -0.8, 0.8, 0.25, "change of that power from light to heavy loads", 0.1),
        EffectParameter("speed", "", 0.0, -2.0, 2.0, 0.3, "power of the elevator's speed beside the model's", 0.2),
    ),
    reading=_reading,
    measured=True,
    rank=3,
)
