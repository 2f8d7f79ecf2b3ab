"""Restitution that falls with impact speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import exp, maximum, minimum
from yieldmon.physics.stages import Impulse, Setting

from .effect import Effect, EffectParameter, Values, where_restitution
from .rebound import restitution, scale_restitution
from .speed_power import log_growth

_YIELD_SPEED = 0.75
"""Speed from which contact yields, in nominal tip speeds, under `_yielding`."""


def _impulse(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    machine = setting.machine
    nominal_m_s = machine.paddle_length_m * machine.nominal_elevator_speed_rad_s
    speed = maximum(impulse.arrival.normal_speed_m_s, np.asarray(1e-3)) / nominal_m_s
    factor = speed ** (-values["exponent"])
    e = restitution(impulse, setting)
    limit = 1.0 / maximum(e, np.asarray(1e-9))
    return replace(impulse, normal_gain=scale_restitution(impulse, minimum(factor, limit), setting))


def _yielding(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    machine = setting.machine
    nominal_m_s = machine.paddle_length_m * machine.nominal_elevator_speed_rad_s
    excess = maximum(impulse.arrival.normal_speed_m_s / nominal_m_s - _YIELD_SPEED, np.asarray(0.0))
    factor = 1.0 / (1.0 + values["rate"] * excess)
    return replace(impulse, normal_gain=scale_restitution(impulse, factor, setting))


@where_restitution
def _by_power(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    machine = setting.machine
    nominal_m_s = machine.paddle_length_m * machine.nominal_elevator_speed_rad_s
    speed = maximum(impulse.arrival.normal_speed_m_s, np.asarray(1e-3)) / nominal_m_s
    factor = exp(-values["exponent"] * log_growth(speed, values["power"]))
    limit = 1.0 / maximum(restitution(impulse, setting), np.asarray(1e-9))
    return replace(impulse, normal_gain=scale_restitution(impulse, minimum(factor, limit), setting))


EFFECT = Effect(
    name="speed_dependent_restitution",
    stage="impact",
    of_grain=True,
    summary="Faster impacts are less elastic.",
    signature="gain falls with elevator speed and towards normal incidence",
    source="e ~ v^(-1/4) for plastic contact: Johnson, Contact Mechanics (1985), section 11.5",
    parameters=(
        EffectParameter("exponent", "", 0.0, 0.0, 1.0, 0.2, "-d(log e) / d(log normal speed), e given at tip speed", 0.5),
    ),
    impulse=_impulse,
)

LAWS = (
    replace(
        EFFECT,
        name="speed_dependent_restitution-yielding",
        law="elastic up to three quarters of the tip's speed, less and less above",
        source="yield velocity of contact: Thornton, J. Appl. Mech. 64 (1997)",
        parameters=(EffectParameter("rate", "", 0.0, 0.0, 4.0, 0.5, "1 / excess speed (in tip speeds) that halves e", 0.7),),
        impulse=_yielding,
    ),
    replace(
        EFFECT,
        name="speed_dependent_restitution-by_power",
        law="log restitution falls with a free power of the normal speed; where the impact's gain is 1 + restitution",
        source="between a power of speed and an exponential: Box and Cox, J. R. Stat. Soc. B 26 (1964)",
        parameters=(
            EffectParameter("exponent", "", 0.0, -0.5, 2.0, 0.2, "-d(log e) / d(log normal speed) at tip speed", 0.5),
            EffectParameter("power", "", 1.0, -0.5, 6.0, 1.5, "power of speed that log e goes with; 0: log speed", 2.0),
        ),
        impulse=_by_power,
    ),
)
