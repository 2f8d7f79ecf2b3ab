"""Friction of grain on the paddle that changes with elevator speed."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.stages import Setting

from .effect import Effect, EffectParameter, Values


def _setting(setting: Setting, values: Values) -> Setting:
    return replace(setting, friction=setting.friction * setting.speed_ratio ** values["exponent"])


EFFECT = Effect(
    name="speed_dependent_friction",
    stage="release",
    of_grain=True,
    summary="Grain slides along the paddle with more or less friction as the elevator turns faster.",
    signature="the angle profile turns with speed, alike at every load; nothing at the nominal speed",
    source="friction of [8.10], held constant by the published model, as a power of speed, with which grain's sliding goes",
    parameters=(EffectParameter("exponent", "", 0.0, -2.0, 2.0, 0.5, "d(log friction) / d(log speed)", 0.7),),
    setting=_setting,
)


def _by_sliding(setting: Setting, values: Values) -> Setting:
    return replace(setting, steady_drag_m_s=values["steady_m_s"])


LAWS = (
    replace(
        EFFECT,
        name="speed_dependent_friction-by_sliding",
        law="friction is mu + d / v at the sliding speed v: a part of the force is the same however fast the grain slides",
        source="dry friction that falls with the sliding speed, by its secant: Armstrong-Helouvry, Dupont and Canudas de Wit, "
        "Automatica 30 (1994), section 2",
        parameters=(EffectParameter("steady_m_s", "m/s", 0.0, -0.5, 1.0, 0.2, "d: friction's steady part times speed", 0.3),),
        setting=_by_sliding,
    ),
)
