"""Friction between grain and plate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import minimum, real
from yieldmon.physics.stages import Impulse, Setting

from .effect import Effect, EffectParameter, Values

_ROLLING_SHARE = 2.0 / 7.0
"""Share of tangential speed that a sliding solid sphere gives up by the time it rolls."""


def _rubbed(impulse: Impulse, values: Values, setting: Setting, most: float) -> Impulse:
    """Coulomb friction, at most the share `most` of the momentum along the plate."""
    arrival = impulse.arrival
    tangential = arrival.tangential_speed_m_s
    sense = np.where(real(tangential) >= 0.0, 1.0, -1.0)
    # Where the exchange coefficients carry a sensor's unit, both limits are in that unit.
    unit = 1.0 if setting.restitution is not None else impulse.normal_gain
    sliding = values["coefficient"] * impulse.normal_gain * arrival.normal_speed_m_s
    slides = real(values["coefficient"] * sense) != 0.0
    rubbed = np.where(slides, minimum(sliding, most * sense * tangential * unit), sliding)
    return replace(impulse, tangential_m_s=impulse.tangential_m_s + sense * rubbed)


def _impulse(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    return _rubbed(impulse, values, setting, _ROLLING_SHARE)


def _sliding(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    return _rubbed(impulse, values, setting, 1.0)


def _by_speed(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    unit = 1.0 if setting.restitution is not None else impulse.normal_gain
    dragged = values["share"] * impulse.arrival.tangential_speed_m_s * unit
    return replace(impulse, tangential_m_s=impulse.tangential_m_s + dragged)


EFFECT = Effect(
    name="plate_friction",
    stage="impact",
    summary="Grain drags along the plate as it strikes: Coulomb friction up to the impulse that makes it roll, or stops it.",
    signature="factor 1 + mu_p cot(phi) where grain slides: more at low plate angles, nothing at 90 deg",
    source="oblique impact of spheres: Walton and Braun, Journal of Rheology 30 (1986); Maw, Barber, Fawcett, Wear 38 (1976)",
    parameters=(EffectParameter("coefficient", "", 0.0, 0.0, 1.0, 0.2, "friction between grain and plate", 0.15),),
    impulse=_impulse,
)

LAWS = (
    replace(
        EFFECT,
        name="plate_friction-sliding",
        law="sliding to the end: kernels held by their neighbours do not roll",
        source="Coulomb's law for a stream of angular grain, up to the impulse that stops it along the plate",
        impulse=_sliding,
    ),
    replace(
        EFFECT,
        name="plate_friction-by_speed",
        law="in proportion to the speed along the plate",
        source="viscous limit: a film of dust or juice on the plate",
        parameters=(
            EffectParameter("share", "", 0.0, 0.0, 0.8, 0.1, "share of the speed along the plate that is given up", 0.1),
        ),
        impulse=_by_speed,
    ),
)
