"""A cell whose answer depends on where on the plate the grain lands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import maximum, minimum, real
from yieldmon.physics.stages import Impulse, Setting

from .effect import Effect, EffectParameter, Values


def _impulse(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    length = setting.machine.plate_length_m
    kappa = np.where(np.isfinite(real(impulse.arrival.from_low_edge_m)), impulse.arrival.from_low_edge_m, 0.0)
    # Grain can push on the plate only: what lands beyond an edge counts as landing on it.
    place = maximum(minimum(kappa / length + 0.5, np.asarray(0.5)), np.asarray(-0.5))
    return replace(impulse, weight=impulse.weight * (1.0 + values["slope"] * place))


EFFECT = Effect(
    name="lever_arm",
    stage="sensor",
    summary="The cell weighs an impact by its distance from the middle of the plate.",
    signature="changes the angle profile: the place of impact moves along the plate with angle and load",
    source="statics of a plate on one cell",
    parameters=(
        EffectParameter("slope", "", 0.0, -1.5, 1.5, 0.3, "change of response over the plate's length, low edge +", 0.3),
    ),
    impulse=_impulse,
)
