"""A heap of another shape than the shape ratio says."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.stages import Setting

from .effect import Effect, EffectParameter, Values


def _setting(setting: Setting, values: Values) -> Setting:
    return replace(setting, shape_ratio=setting.shape_ratio * (1.0 + values["change"]))


EFFECT = Effect(
    name="heap_shape",
    stage="settle",
    of_grain=True,
    summary="The heap on the paddle is steeper or flatter than the shape ratio says.",
    signature="the load at which force bends over moves, at every angle and speed alike",
    source="shape ratio h_f as an unknown: source thesis, chapter 8; 2.8 to 3.9 in the project's own discrete-element records",
    parameters=(EffectParameter("change", "", 0.0, -0.5, 1.2, 0.3, "relative change of the shape ratio", 0.4),),
    setting=_setting,
)
