"""Grain that already moves outward when its paddle reaches the release point."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.stages import Setting

from .effect import Effect, EffectParameter, Values


def _setting(setting: Setting, values: Values) -> Setting:
    return replace(setting, radial_speed=values["share"])


EFFECT = Effect(
    name="residual_radial_speed",
    stage="release",
    of_grain=True,
    summary="Grain does not start from rest on the paddle but with a radial speed.",
    signature="the jet leaves earlier, faster and higher: more at low plate angles than at high ones",
    source="the source thesis's own hypothesis for its residuals; initial condition of [8.13]",
    parameters=(EffectParameter("share", "", 0.0, 0.0, 1.0, 0.1, "radial speed over (elevator speed x radius)", 0.2),),
    setting=_setting,
)
