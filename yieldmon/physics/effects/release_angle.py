"""A housing that lets the grain go before or after the paddle stands upright."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.stages import Setting

from .effect import Effect, EffectParameter, Values


def _setting(setting: Setting, values: Values) -> Setting:
    return replace(setting, release_angle_rad=values["angle_rad"])


EFFECT = Effect(
    name="release_angle",
    stage="release",
    summary="The housing's edge is not at the top of the paddle's circle.",
    signature="the whole jet turned by one angle, the same at every mass and speed",
    source="geometry: start angle 3 pi/2 of [8.16]",
    parameters=(EffectParameter("angle_rad", "rad", 0.0, -0.6, 0.5, 0.1, "paddle angle at release, past the vertical", -0.1),),
    setting=_setting,
)
