"""Grain that leaves in a fan instead of along one path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import erf

from yieldmon.physics.numerics import maximum, real
from yieldmon.physics.stages import Arrival, Setting

from .effect import Effect, EffectParameter, Values


def _arrival(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    spread = values["spread_rad"]
    meets = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    normal = np.where(meets, arrival.normal_speed_m_s, 1.0)
    speed = np.sqrt(normal**2 + arrival.tangential_speed_m_s**2)
    length = np.where(meets, arrival.flight_length_m, 1.0)
    # A fan of half width s covers L s / cos(incidence) along the plate.
    width = np.sqrt(2.0) * spread * maximum(length, np.asarray(1e-3)) * speed / normal
    fans_out = real(width) > 0.0
    beyond = np.where(meets, arrival.from_low_edge_m, 1.0) / np.where(fans_out, width, 1.0)
    # erf is 1 to rounding from 6 on, and its complex continuation overflows far out.
    beyond = np.where(real(beyond) > 6.0, 6.0, np.where(real(beyond) < -6.0, -6.0, beyond))
    smeared = np.where(meets, 0.5 * (1.0 - erf(beyond)), 0.0)
    return replace(
        arrival,
        landing_share=np.where(fans_out, smeared, arrival.landing_share),
        normal_speed_m_s=arrival.normal_speed_m_s * np.exp(-0.5 * spread**2),
        tangential_speed_m_s=arrival.tangential_speed_m_s * np.exp(-0.5 * spread**2),
    )


EFFECT = Effect(
    name="stream_spread",
    stage="flight",
    summary="Grain leaves the tip in a fan of directions, so that the plate's low edge cuts it softly.",
    signature="smeared low edge: gain at low plate angles where grain misses, loss where it hits; a uniform loss of s^2/2",
    source="Gaussian fan of directions about the path of [8.17]",
    parameters=(
        EffectParameter("spread_rad", "rad", 0.0, 0.0, 0.5, 0.1, "standard deviation of direction", 0.15),
    ),
    arrival=_arrival,
    needs_misses=True,
)
