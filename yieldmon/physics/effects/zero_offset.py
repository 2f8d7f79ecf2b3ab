"""A force reading that is there without any grain."""

from __future__ import annotations

from yieldmon.physics.stages import Reading, Setting

from .effect import Effect, EffectParameter, Values, with_force


def _reading(reading: Reading, values: Values, setting: Setting) -> Reading:
    return with_force(reading, values["force_n"], setting)


EFFECT = Effect(
    name="zero_offset",
    stage="sensor",
    summary="The zero-load reading has drifted since it was last taken.",
    signature="a constant force, the same at every plate angle, flow and speed",
    source="sensor: affine force cell",
    parameters=(EffectParameter("force_n", "N", 0.0, -20.0, 20.0, 2.0, "force read with no grain", 2.0),),
    reading=_reading,
    unit_follows_response=True,
)
