"""A heap that was pressed against the housing and swells as it leaves: the stream rises, and part of it clears the plate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, exp, power, real
from yieldmon.physics.stages import Arrival, Impulse, Jet, Setting

from .edges import KERNEL_M, blur_low_edge, share_beyond
from .effect import Effect, EffectParameter, Values, where_restitution

_FULL_BLUR_RATIO = 0.02
"""Rise from which on the edges cut over a whole kernel; below it they sharpen towards the published cut."""


def _jet(jet: Jet, values: Values, setting: Setting) -> Jet:
    depth_m = setting.paddle_length_m * (jet.release_radius - jet.inner_radius)
    rise = values["ratio"] * setting.elevator_speed_rad_s * np.where(real(depth_m) > 0.0, depth_m, 0.0)
    since = jet.travel_angle_rad / setting.elevator_speed_rad_s
    return replace(jet, y_m=jet.y_m - rise * since, vy_m_s=jet.vy_m_s - rise)


@where_restitution
def _jet_by_power(jet: Jet, values: Values, setting: Setting) -> Jet:
    depth = jet.release_radius - jet.inner_radius
    depth = np.where(real(depth) > 0.0, depth, 0.0)
    rise = values["ratio"] * setting.elevator_speed_rad_s * setting.paddle_length_m * power(depth, values["depth_power"])
    since = jet.travel_angle_rad / setting.elevator_speed_rad_s
    return replace(jet, y_m=jet.y_m - rise * since, vy_m_s=jet.vy_m_s - rise)


def _blur_m(values: Values) -> AnyArray:
    width: AnyArray = values.get("edge_m", np.asarray(KERNEL_M)) * (1.0 - exp(-values["ratio"] / _FULL_BLUR_RATIO))
    return width


def _arrival(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    return blur_low_edge(arrival, _blur_m(values))


@where_restitution
def _arrival_by_power(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    return _arrival(arrival, values, setting)


@where_restitution
def _impulse_by_power(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    return _impulse(impulse, values, setting)


def _impulse(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    arrival, width = impulse.arrival, _blur_m(values)
    blurs = real(width) > 0.0
    meets = np.isfinite(real(arrival.from_low_edge_m))
    below_top = np.where(meets, arrival.from_low_edge_m, 0.0) + setting.machine.plate_length_m
    cleared = np.where(blurs, share_beyond(below_top, np.where(blurs, width, 1.0)), 1.0)
    return replace(impulse, arrival=replace(arrival, landing_share=arrival.landing_share * cleared))


EFFECT = Effect(
    name="stream_rise",
    stage="release",
    of_grain=True,
    summary="The heap was pressed against the housing and swells where that ends: outer grain leaves upwards, some of it over "
    "the plate's top edge.",
    signature="loss over the top edge that grows with load and, beside gravity, with speed; less at low plate angles, where what "
    "rises clears the low edge",
    source="the project's own discrete-element records (studies/dem, release): rise of ratio Omega (rho_0 - h0); pressure in a "
    "rotating granular heap, eta Omega^2 (rho_0^2 - h0^2) / 2",
    parameters=(
        EffectParameter("ratio", "", 0.0, 0.0, 0.4, 0.1, "upward speed over Omega times the depth of grain inside", 0.15),
    ),
    jet=_jet,
    arrival=_arrival,
    impulse=_impulse,
    needs_misses=True,
    rank=1,
)

LAWS = (
    replace(
        EFFECT,
        name="stream_rise-by_power",
        law="rise by a free power of the depth of grain inside, and edges that cut over a free width; where the impact's gain is "
        "1 + restitution",
        source="speed by the root of pressure where grain is free to flow (Bernoulli), in proportion to it where it is braked",
        parameters=(
            EffectParameter("ratio", "", 0.0, 0.0, 0.5, 0.1, "upward speed over tip speed, at a paddle's depth", 0.15),
            EffectParameter("depth_power", "", 0.8, 0.3, 2.0, 0.4, "power of depth that the rise goes with", 1.2),
            EffectParameter("edge_m", "m", 0.015, 0.005, 0.05, 0.01, "width over which the edges cut the stream", 0.03),
        ),
        jet=_jet_by_power,
        arrival=_arrival_by_power,
        impulse=_impulse_by_power,
    ),
)
