"""Paddles worn short at the tip."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.stages import Setting

from .effect import Effect, EffectParameter, Values


def _setting(setting: Setting, values: Values) -> Setting:
    return replace(setting, paddle_length_m=setting.paddle_length_m - values["length_m"])


EFFECT = Effect(
    name="paddle_wear",
    stage="fill",
    summary="Paddles have lost length, so that grain leaves at a smaller radius and a paddle holds less.",
    signature="tip speed and full load fall together, as l and l^2; the jet starts lower",
    source="geometry of [8.4-8.20] with a shorter l",
    parameters=(EffectParameter("length_m", "m", 0.0, 0.0, 0.05, 0.005, "length lost at the tip", 0.01),),
    setting=_setting,
)
