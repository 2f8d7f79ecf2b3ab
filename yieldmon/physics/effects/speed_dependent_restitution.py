"""Restitution that falls with impact speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import maximum, minimum
from yieldmon.physics.stages import Impulse, Setting

from .effect import Effect, EffectParameter, Values
from .rebound import restitution, scale_restitution


def _impulse(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    machine = setting.machine
    nominal_m_s = machine.paddle_length_m * machine.nominal_elevator_speed_rad_s
    speed = maximum(impulse.arrival.normal_speed_m_s, np.asarray(1e-3)) / nominal_m_s
    factor = speed ** (-values["exponent"])
    e = restitution(impulse, setting)
    limit = 1.0 / maximum(e, np.asarray(1e-9))
    return replace(impulse, normal_gain=scale_restitution(impulse, minimum(factor, limit), setting))


EFFECT = Effect(
    name="speed_dependent_restitution",
    stage="impact",
    summary="Faster impacts are less elastic.",
    signature="gain falls with elevator speed and towards normal incidence",
    source="e ~ v^(-1/4) for plastic contact: Johnson, Contact Mechanics (1985), section 11.5",
    parameters=(
        EffectParameter("exponent", "", 0.0, 0.0, 1.0, 0.2, "-d(log e) / d(log normal speed), e given at tip speed", 0.5),
    ),
    impulse=_impulse,
)
