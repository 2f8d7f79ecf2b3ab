"""Grain that lies on the plate for a while."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.stages import Reading, Setting

from .effect import Effect, EffectParameter, Values

_GRAVITY_M_S2 = 9.81


def _reading(reading: Reading, values: Values, setting: Setting) -> Reading:
    arrival = reading.impulse.arrival
    landed = np.sum(arrival.landing_share * arrival.jet.mass_kg, axis=-1, keepdims=True)
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s + landed * _GRAVITY_M_S2 * values["time_s"])


EFFECT = Effect(
    name="resting_grain",
    stage="impact",
    of_grain=True,
    summary="Grain stays on the plate for a time, and its weight is read as force.",
    signature="adds m-dot g t: in proportion to flow, whatever the speed of the stream and nearly whatever the plate angle",
    source="weight of the grain held on the plate, m-dot t g",
    parameters=(EffectParameter("time_s", "s", 0.0, 0.0, 0.3, 0.05, "time that grain stays", 0.05),),
    reading=_reading,
    unit_follows_response=True,
)
