"""Stage 4b, impact: what the landing grain gives to the plate [8.21-8.24, appendix M]."""

from __future__ import annotations

import numpy as np

from .numerics import AnyArray
from .stages import Arrival, Impulse, Reading, Setting


def strike(arrival: Arrival, setting: Setting) -> Impulse:
    """Normal gain 1 + e [8.22], or k1 M / M_full + k2 where exchange coefficients are given [10.1]; smooth plate."""
    if setting.restitution is not None:
        gain = 1.0 + setting.restitution
    else:
        assert setting.k1 is not None
        assert setting.k2 is not None
        gain = setting.k1 * arrival.jet.load.paddle_mass_kg / setting.full_paddle_mass_kg + setting.k2
    return Impulse(arrival, gain, np.zeros(1), np.ones(1))


def read(impulse: Impulse, setting: Setting) -> Reading:
    """Horizontal momentum per paddle: the sum over nodes, which turns the plate's frame into the horizontal [8.24]."""
    arrival = impulse.arrival
    normal = impulse.normal_gain * arrival.normal_speed_m_s * np.sin(setting.plate_angle_rad)
    horizontal: AnyArray = normal + impulse.tangential_m_s * np.cos(setting.plate_angle_rad)
    landed = arrival.landing_share * arrival.jet.mass_kg
    terms: AnyArray = np.where(landed != 0.0, landed * impulse.weight * horizontal, 0.0)
    return Reading(impulse, np.sum(terms, axis=-1, keepdims=True))
