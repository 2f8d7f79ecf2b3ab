"""A heap that was pressed against the housing and swells as it leaves: the stream rises, and part of it clears the plate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, exp, real
from yieldmon.physics.stages import Arrival, Impulse, Jet, Setting

from .edges import KERNEL_M, blur_low_edge, share_beyond
from .effect import Effect, EffectParameter, Values

_FULL_BLUR_RATIO = 0.02
"""Rise from which on the edges cut over a whole kernel; below it they sharpen towards the published cut."""


def _jet(jet: Jet, values: Values, setting: Setting) -> Jet:
    depth_m = setting.paddle_length_m * (jet.release_radius - jet.inner_radius)
    rise = values["ratio"] * setting.elevator_speed_rad_s * np.where(real(depth_m) > 0.0, depth_m, 0.0)
    since = jet.travel_angle_rad / setting.elevator_speed_rad_s
    return replace(jet, y_m=jet.y_m - rise * since, vy_m_s=jet.vy_m_s - rise)


def _blur_m(values: Values) -> AnyArray:
    width: AnyArray = KERNEL_M * (1.0 - exp(-values["ratio"] / _FULL_BLUR_RATIO))
    return width


def _arrival(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    return blur_low_edge(arrival, _blur_m(values))


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
