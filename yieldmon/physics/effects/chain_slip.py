"""Paddles that run slower than the speed sensor says."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.stages import Setting

from .effect import Effect, EffectParameter, Values


def _setting(setting: Setting, values: Values) -> Setting:
    return replace(setting, elevator_speed_rad_s=setting.elevator_speed_rad_s * (1.0 - values["share"]))


EFFECT = Effect(
    name="chain_slip",
    stage="fill",
    summary="The chain slips or the speed is measured on the wrong shaft: paddles run slower than stated.",
    signature="every speed scaled by one factor: momentum in proportion, more grain on each paddle for a given flow",
    source="kinematics of [8.1] with V = (1 - slip) Omega r_s",
    parameters=(EffectParameter("share", "", 0.0, -0.05, 0.3, 0.02, "share of the speed that is lost", 0.05),),
    setting=_setting,
)
