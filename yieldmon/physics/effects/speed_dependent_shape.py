"""A heap whose shape changes with elevator speed."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.stages import Setting

from .effect import Effect, EffectParameter, Values


def _setting(setting: Setting, values: Values) -> Setting:
    return replace(setting, shape_ratio=setting.shape_ratio * setting.speed_ratio ** values["exponent"])


EFFECT = Effect(
    name="speed_dependent_shape",
    stage="settle",
    of_grain=True,
    summary="The heap lies flatter or steeper against the housing as the elevator turns faster.",
    signature="the curve over fill changes with speed; nothing at the nominal speed",
    source="shape ratio h_f of [8.4], held constant by the published model, as a power of speed",
    parameters=(EffectParameter("exponent", "", 0.0, -2.0, 2.0, 0.3, "d(log shape ratio) / d(log speed)", 1.0),),
    setting=_setting,
)
