"""A force cell that is not linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import maximum, power, sqrt
from yieldmon.physics.stages import Reading, Setting

from .effect import Effect, EffectParameter, Values, where_restitution

_MIDDLE_N = 50.0
"""Force at which the laws mean the same by softening."""


def _reading(reading: Reading, values: Values, setting: Setting) -> Reading:
    force = reading.momentum_kg_m_s * setting.passes_per_s
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s / (1.0 + values["softening_per_n"] * force))


def _saturating(reading: Reading, values: Values, setting: Setting) -> Reading:
    share = values["softening_per_n"] * reading.momentum_kg_m_s * setting.passes_per_s
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s / sqrt(1.0 + share * share))


@where_restitution
def _by_power(reading: Reading, values: Values, setting: Setting) -> Reading:
    force = reading.momentum_kg_m_s * setting.passes_per_s / _MIDDLE_N
    softer = values["softening_per_n"] * _MIDDLE_N * power(maximum(force, np.asarray(0.0)), values["power"])
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s / (1.0 + softer))


EFFECT = Effect(
    name="cell_nonlinearity",
    stage="sensor",
    summary="The cell reads less than in proportion as the force grows (or more).",
    signature="a curve over force alone: loads, angles and speeds that give the same force read the same",
    source="cell characteristic F / (1 + c F)",
    parameters=(EffectParameter("softening_per_n", "1/N", 0.0, -0.001, 0.01, 0.0005, "relative loss per force", 0.001),),
    reading=_reading,
    unit_follows_response=True,
)

LAWS = (
    replace(
        EFFECT,
        name="cell_nonlinearity-saturating",
        law="straight at small forces, saturating at large ones",
        source="cell characteristic F / sqrt(1 + (c F)^2)",
        parameters=(EffectParameter("softening_per_n", "1/N", 0.0, 0.0, 0.02, 0.002, "1 / force at saturation", 0.004),),
        reading=_saturating,
    ),
    replace(
        EFFECT,
        name="cell_nonlinearity-by_power",
        law="the relative loss goes with a free power of force; where the impact's gain is 1 + restitution",
        source="yielding with a power of stress: Ramberg and Osgood, NACA Technical Note 902 (1943)",
        parameters=(
            EffectParameter("softening_per_n", "1/N", 0.0, -0.001, 0.01, 0.0005, "relative loss per force, at 50 N", 0.001),
            EffectParameter("power", "", 1.0, 0.2, 3.0, 0.5, "power of force that the relative loss goes with", 1.5),
        ),
        reading=_by_power,
    ),
)
