"""Grain that lies on the plate for a while."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, maximum, power
from yieldmon.physics.stages import GRAVITY_M_S2, Reading, Setting

from .effect import Effect, EffectParameter, Values, where_restitution


def _pressing(reading: Reading, values: Values, gravity_m_s2: AnyArray | float) -> AnyArray:
    """Momentum per paddle of the weight that lies on the plate."""
    arrival = reading.impulse.arrival
    landed: AnyArray = np.sum(arrival.landing_share * arrival.jet.mass_kg, axis=-1, keepdims=True)
    return landed * gravity_m_s2 * values["time_s"]


def _reading(reading: Reading, values: Values, setting: Setting) -> Reading:
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s + _pressing(reading, values, GRAVITY_M_S2))


def _across(reading: Reading, values: Values, setting: Setting) -> Reading:
    if setting.gravity_m_s2 is None:
        return reading
    across = _pressing(reading, values, setting.gravity_m_s2) * np.cos(setting.plate_angle_rad)
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s + across * np.sin(setting.plate_angle_rad))


@where_restitution
def _by_slope(reading: Reading, values: Values, setting: Setting) -> Reading:
    across = _pressing(reading, values, GRAVITY_M_S2) * np.cos(setting.plate_angle_rad)
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s + across)


@where_restitution
def _whole_flow(reading: Reading, values: Values, setting: Setting) -> Reading:
    weight = reading.impulse.arrival.jet.load.paddle_mass_kg * GRAVITY_M_S2
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s + weight * values["time_s"])


@where_restitution
def _leaning(reading: Reading, values: Values, setting: Setting) -> Reading:
    slope = power(maximum(np.cos(setting.plate_angle_rad), np.asarray(0.0)), values["slope_power"])
    lies = values["leaning"] + (1.0 - values["leaning"]) * slope
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s + _pressing(reading, values, GRAVITY_M_S2) * lies)


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

LAWS = (
    replace(
        EFFECT,
        name="resting_grain-across_plate",
        law="only the part of the weight across the plate presses, and its horizontal part is read; where the model has gravity",
        source="statics of a body on an incline, m-dot t g cos(phi) across the plate",
        reading=_across,
    ),
    replace(
        EFFECT,
        name="resting_grain-by_slope",
        law="only the part of the weight across the plate is read; where the impact's gain is 1 + restitution",
        source="statics of a body on an incline, m-dot t g cos(phi) across the plate, on a cell that turns with it",
        reading=_by_slope,
    ),
    replace(
        EFFECT,
        name="resting_grain-whole_flow",
        law="of all grain, also what is thought to pass below the plate; where the impact's gain is 1 + restitution",
        source="m-dot t g as it is commonly written; dense granular jets deflect as a whole: Cheng et al., Physical Review "
        "Letters 99, 188001 (2007)",
        reading=_whole_flow,
    ),
    replace(
        EFFECT,
        name="resting_grain-leaning",
        law="a share leans on the plate whatever its slope, the rest presses the less the steeper it is; where the "
        "impact's gain is 1 + restitution",
        source="thrust of a pile on a wall beside the weight of a body on an incline, from which it runs the sooner the steeper: "
        "Nedderman, Statics and Kinematics of Granular Materials (1992), chapter 4",
        parameters=(
            EffectParameter("time_s", "s", 0.0, 0.0, 0.5, 0.05, "time that grain stays", 0.05),
            EffectParameter("leaning", "", 0.5, 0.0, 1.0, 0.3, "share that leans on the plate", 0.8),
            EffectParameter("slope_power", "", 1.0, 0.5, 3.0, 0.5, "power of the slope's cosine that the rest goes with", 1.5),
        ),
        reading=_leaning,
    ),
)
