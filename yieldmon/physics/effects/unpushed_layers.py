"""Layers of the heap that lie ahead of the paddle and are not pushed by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import erf

from yieldmon.physics import release, settling
from yieldmon.physics.numerics import AnyArray, real
from yieldmon.physics.stages import Arrival, Jet, Setting

from .effect import Effect, EffectParameter, Values

_EDGE_M = 0.01
"""About one kernel: what a stream of unequal grain blurs the cut of the plate's low edge by."""


def _free_share(angle_rad: AnyArray, rate_per_rad: AnyArray) -> AnyArray:
    share: AnyArray = 1.0 - np.exp(-rate_per_rad * np.where(real(angle_rad) > 0.0, angle_rad, 0.0))
    return share


def _jet(jet: Jet, values: Values, setting: Setting) -> Jet:
    angle = settling.opening_angle(jet.release_radius, jet.inner_radius, setting.shape_ratio)
    share = _free_share(angle, values["rate_per_rad"])
    start = release.start_angle(setting)
    sin, cos = np.sin(start), np.cos(start)
    radius = setting.paddle_length_m * jet.release_radius
    around = setting.elevator_speed_rad_s * radius
    outward = 0.0 if setting.radial_speed is None else setting.radial_speed * around
    fall = 0.0 if setting.gravity_m_s2 is None else setting.gravity_m_s2
    # Where free grain is at the moment at which the paddle would have thrown it.
    time = jet.travel_angle_rad / setting.elevator_speed_rad_s
    vx, vy = outward * cos - around * sin, outward * sin + around * cos
    x, y = radius * cos + vx * time, radius * sin + (vy + 0.5 * fall * time) * time
    return replace(
        jet,
        x_m=jet.x_m + share * (x - jet.x_m),
        y_m=jet.y_m + share * (y - jet.y_m),
        vx_m_s=jet.vx_m_s + share * (vx - jet.vx_m_s),
        vy_m_s=jet.vy_m_s + share * (vy + fall * time - jet.vy_m_s),
    )


def _arrival(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    meets = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    reach = setting.shape_ratio * (1.0 - arrival.jet.inner_radius)
    width = _EDGE_M * _free_share(reach, values["rate_per_rad"])
    blurs = real(width) > 0.0
    beyond = np.where(meets, arrival.from_low_edge_m, 1.0) / np.where(blurs, width, 1.0)
    # erf is 1 to rounding from 6 on, and its complex continuation overflows far out.
    beyond = np.where(real(beyond) > 6.0, 6.0, np.where(real(beyond) < -6.0, -6.0, beyond))
    landing = np.where(meets, 0.5 * (1.0 - erf(beyond)), 0.0)
    return replace(arrival, landing_share=np.where(blurs, landing, arrival.landing_share))


EFFECT = Effect(
    name="unpushed_layers",
    stage="release",
    summary="Layers ahead of the paddle are not pushed by it: they fly on from the housing's edge as they were carried.",
    signature="the jet leaves higher and slower, the more the further the heap reaches ahead: more at large loads, most at low "
    "plate angles, whose edge it clears; the same at every speed",
    source="the project's own discrete-element records (docs/dem.md, release): Omega rho_0 and level, share 1 - exp(-rate psi)",
    parameters=(
        EffectParameter(
            "rate_per_rad", "1/rad", 0.0, 0.0, 20.0, 3.0, "share of grain set free per angle that its layer reaches ahead", 3.0
        ),
    ),
    jet=_jet,
    arrival=_arrival,
    needs_misses=True,
)
