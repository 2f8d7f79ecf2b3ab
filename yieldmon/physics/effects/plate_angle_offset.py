"""A plate that does not stand at the angle its actuator reports."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.stages import Setting

from .effect import Effect, EffectParameter, Values


def _setting(setting: Setting, values: Values) -> Setting:
    return replace(setting, plate_angle_rad=setting.plate_angle_rad + values["angle_rad"])


EFFECT = Effect(
    name="plate_angle_offset",
    stage="sensor",
    summary="The plate's true angle differs from the reported one by a fixed amount.",
    signature="d<F>/d(phi) times the offset: an S over plate angle, the same share at every flow",
    source="geometry",
    parameters=(EffectParameter("angle_rad", "rad", 0.0, -0.15, 0.15, 0.02, "true minus reported angle", 0.05),),
    setting=_setting,
)
