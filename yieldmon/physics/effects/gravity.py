"""Gravity on the paddle and in flight, which the published model drops."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.stages import GRAVITY_M_S2, Setting

from .effect import Effect, EffectParameter, Values


def _setting(setting: Setting, values: Values) -> Setting:
    return replace(setting, gravity_m_s2=values["acceleration_m_s2"])


EFFECT = Effect(
    name="gravity",
    stage="flight",
    of_grain=True,
    summary="Gravity slows the grain's way out along the paddle and bends its path to the plate.",
    signature="drop of about g L / v^2: grows as the elevator slows; more at low plate angles, where the low edge is near",
    source="equation of motion behind [8.10] with gravity kept; projectile motion",
    parameters=(EffectParameter("acceleration_m_s2", "m/s2", 0.0, 0.0, 12.0, 1.0, "acceleration downwards", GRAVITY_M_S2),),
    setting=_setting,
)
