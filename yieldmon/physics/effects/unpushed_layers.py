"""Layers of the heap that lie ahead of the paddle and are not pushed by it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from yieldmon.physics import release, settling
from yieldmon.physics.numerics import AnyArray, exp, power, real
from yieldmon.physics.stages import Arrival, Jet, Setting

from .edges import KERNEL_M, blur_low_edge
from .effect import Effect, EffectParameter, Values, where_restitution

_DRAWN_ALONG = 0.5
"""How far the grain that follows brings a free layer's speed from its own towards the tip's (mean of all records)."""


def _free_share(angle_rad: AnyArray, rate_per_rad: AnyArray) -> AnyArray:
    share: AnyArray = 1.0 - exp(-rate_per_rad * np.where(real(angle_rad) > 0.0, angle_rad, 0.0))
    return share


def _beyond_reach(angle_rad: AnyArray, rate_per_rad: AnyArray) -> AnyArray:
    ahead = rate_per_rad * np.where(real(angle_rad) > 0.0, angle_rad, 0.0)
    far = real(ahead) > 1.0
    share: AnyArray = np.where(far, 1.0 - 1.0 / np.where(far, ahead, 1.0), 0.0)
    return share


def _both(carried: AnyArray, free: AnyArray) -> AnyArray:
    return np.concatenate(np.broadcast_arrays(carried, free), axis=-1)


def _jet(jet: Jet, values: Values, setting: Setting) -> Jet:
    return _freed(jet, values, setting, _free_share, _DRAWN_ALONG)


def _jet_beyond_reach(jet: Jet, values: Values, setting: Setting) -> Jet:
    return _freed(jet, values, setting, _beyond_reach, _DRAWN_ALONG)


def _jet_own_speed(jet: Jet, values: Values, setting: Setting) -> Jet:
    return _freed(jet, values, setting, _beyond_reach, 0.0)


def _gradual(values: Values) -> Callable[[AnyArray, AnyArray], AnyArray]:
    def share(angle_rad: AnyArray, rate_per_rad: AnyArray) -> AnyArray:
        ahead = rate_per_rad * np.where(real(angle_rad) > 0.0, angle_rad, 0.0)
        free: AnyArray = 1.0 - exp(-power(ahead, values["steepness"]))
        return free

    return share


@where_restitution
def _jet_gradual(jet: Jet, values: Values, setting: Setting) -> Jet:
    return _freed(jet, values, setting, _gradual(values), values["drawn_along"])


@where_restitution
def _arrival_gradual(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    return _blurred(arrival, values, setting, _gradual(values))


def _freed(
    jet: Jet, values: Values, setting: Setting, law: Callable[[AnyArray, AnyArray], AnyArray], drawn_along: AnyArray | float
) -> Jet:
    angle = settling.opening_angle(jet.release_radius, jet.inner_radius, setting.shape_ratio)
    share = law(angle, values["rate_per_rad"])
    start = release.start_angle(setting)
    sin, cos = np.sin(start), np.cos(start)
    radius = setting.paddle_length_m * jet.release_radius
    around = setting.elevator_speed_rad_s * (radius + drawn_along * (setting.paddle_length_m - radius))
    outward = 0.0 if setting.radial_speed is None else setting.radial_speed * around
    fall = 0.0 if setting.gravity_m_s2 is None else setting.gravity_m_s2
    # Where free grain is at the moment at which the paddle would have thrown it.
    time = jet.travel_angle_rad / setting.elevator_speed_rad_s
    vx, vy = outward * cos - around * sin, outward * sin + around * cos
    x, y = radius * cos + vx * time, radius * sin + (vy + 0.5 * fall * time) * time
    return replace(
        jet,
        release_radius=_both(jet.release_radius, jet.release_radius),
        travel_angle_rad=_both(jet.travel_angle_rad, jet.travel_angle_rad),
        mass_kg=_both((1.0 - share) * jet.mass_kg, share * jet.mass_kg),
        x_m=_both(jet.x_m, x),
        y_m=_both(jet.y_m, y),
        vx_m_s=_both(jet.vx_m_s, vx),
        vy_m_s=_both(jet.vy_m_s, vy + fall * time),
    )


def _arrival(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    return _blurred(arrival, values, setting, _free_share)


def _arrival_beyond_reach(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    return _blurred(arrival, values, setting, _beyond_reach)


def _blurred(arrival: Arrival, values: Values, setting: Setting, law: Callable[[AnyArray, AnyArray], AnyArray]) -> Arrival:
    reach = setting.shape_ratio * (1.0 - arrival.jet.inner_radius)
    return blur_low_edge(arrival, KERNEL_M * law(reach, values["rate_per_rad"]))


EFFECT = Effect(
    name="unpushed_layers",
    stage="release",
    of_grain=True,
    summary="Layers ahead of the paddle are not pushed by it: they fly on level from the housing's edge.",
    signature="the jet leaves higher and slower, the more the further the heap reaches ahead: more at large loads, most at low "
    "plate angles, whose edge it clears; the same at every speed",
    source="the project's own discrete-element records (studies/dem, release): level, half way from Omega rho_0 to "
    "the tip's speed; share 1 - exp(-rate psi)",
    parameters=(
        EffectParameter(
            "rate_per_rad", "1/rad", 0.0, 0.0, 20.0, 3.0, "share of grain set free per angle that its layer reaches ahead", 3.0
        ),
    ),
    jet=_jet,
    arrival=_arrival,
    needs_misses=True,
    rank=0,
)

_REACH = (
    EffectParameter(
        "rate_per_rad", "1/rad", 0.0, 0.0, 10.0, 2.0, "1 / angle up to which grain ahead of the paddle is pushed", 3.0
    ),
)

LAWS = (
    replace(
        EFFECT,
        name="unpushed_layers-beyond_reach",
        law="all grain further ahead of the paddle than one angle, and none nearer",
        source="geometry: a layer of opening angle psi has the share 1 - psi_0 / psi beyond psi_0",
        parameters=_REACH,
        jet=_jet_beyond_reach,
        arrival=_arrival_beyond_reach,
    ),
    replace(
        EFFECT,
        name="unpushed_layers-own_speed",
        law="all grain further ahead of the paddle than one angle, at the speed of its own layer",
        source="geometry, as beyond_reach; free flight from the housing's edge, not drawn along by what follows",
        parameters=_REACH,
        jet=_jet_own_speed,
        arrival=_arrival_beyond_reach,
    ),
    replace(
        EFFECT,
        name="unpushed_layers-gradual",
        law="the more grain the further it lies ahead of the paddle, as gradually and as much drawn along as the rows say; where "
        "the impact's gain is 1 + restitution",
        source="survival with a rate that goes with a power of the distance: Weibull, Journal of Applied Mechanics 18 (1951)",
        parameters=(
            EffectParameter("rate_per_rad", "1/rad", 0.0, 0.0, 10.0, 2.0, "1 / angle up to which most grain is pushed", 2.0),
            EffectParameter("steepness", "", 1.5, 0.5, 4.0, 0.75, "1: every angle ahead alike; 4: nearly a limit", 2.5),
            EffectParameter("drawn_along", "", 0.5, 0.0, 1.0, 0.25, "share of the way to the tip's speed", 0.8),
        ),
        jet=_jet_gradual,
        arrival=_arrival_gradual,
    ),
)
