"""A heap whose shape changes with elevator speed."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.numerics import exp
from yieldmon.physics.stages import Setting

from .effect import Effect, EffectParameter, Values
from .speed_power import log_growth


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


def _by_power(setting: Setting, values: Values) -> Setting:
    if setting.restitution is None:
        return setting
    growth = values["exponent"] * log_growth(setting.speed_ratio, values["power"])
    return replace(setting, shape_ratio=setting.shape_ratio * exp(growth))


LAWS = (
    replace(
        EFFECT,
        name="speed_dependent_shape-by_power",
        law="log shape ratio goes with a free power of speed; where the impact's gain is 1 + restitution",
        source="between a power of speed and an exponential: Box and Cox, J. R. Stat. Soc. B 26 (1964)",
        parameters=(
            EffectParameter("exponent", "", 0.0, -2.0, 2.0, 0.3, "d(log shape ratio) / d(log speed) at the nominal speed", 1.0),
            EffectParameter("power", "", 1.0, -8.0, 8.0, 4.0, "power of speed that it goes with; 0: log speed", 4.0),
        ),
        setting=_by_power,
    ),
)
