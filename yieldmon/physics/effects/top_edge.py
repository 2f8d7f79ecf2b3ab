"""Grain that flies over the plate's top edge: the plate's end stops some of it, the stream that runs up the plate turns more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, minimum, real
from yieldmon.physics.stages import Arrival, Impulse, Jet, Setting

from .edges import KERNEL_M, landing_momentum, share_beyond
from .effect import Effect, EffectParameter, Values

_FULL_CUT_M = 0.001
"""Thickness from which on the top edge cuts the stream; below it the cut fades towards the published plate, which has none."""
_BLUR_M = np.asarray(KERNEL_M)


def _runs_up(arrival: Arrival, towards: AnyArray) -> AnyArray:
    """Share of a jet that runs up the plate: (1 - cos) / 2 at the angle between the landing stream and the way down the plate."""
    into, along = landing_momentum(arrival, towards)
    lands = real(into) > 0.0
    cos = np.where(lands, along / np.sqrt(np.where(lands, into * into + along * along, 1.0)), 1.0)
    share: AnyArray = 0.5 * (1.0 - cos)
    return share


def _both(face: AnyArray | float, end: AnyArray | float, like: AnyArray) -> AnyArray:
    """Nodes of the grain on the plate's face, then of that on its end, each in the shape of `like`."""
    return np.concatenate(np.broadcast_arrays(face, end, like)[:2], axis=-1)


def _twice(jet: Jet, like: AnyArray) -> Jet:
    """The jet with each node once for the face and once for the end."""
    return replace(
        jet,
        release_radius=_both(jet.release_radius, jet.release_radius, like),
        mass_kg=_both(jet.mass_kg, jet.mass_kg, like),
        travel_angle_rad=_both(jet.travel_angle_rad, jet.travel_angle_rad, like),
        x_m=_both(jet.x_m, jet.x_m, like),
        y_m=_both(jet.y_m, jet.y_m, like),
        vx_m_s=_both(jet.vx_m_s, jet.vx_m_s, like),
        vy_m_s=_both(jet.vy_m_s, jet.vy_m_s, like),
    )


def _impulse(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    arrival, thickness_m = impulse.arrival, np.asarray(values["thickness_m"])
    towards = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    above_m = -np.where(towards, arrival.from_low_edge_m, 0.0) - setting.machine.plate_length_m
    into = np.where(towards, arrival.normal_speed_m_s, 1.0)
    downwards = towards & (real(arrival.tangential_speed_m_s) > 0.0)
    down = np.where(downwards, arrival.tangential_speed_m_s, 0.0)
    cuts = np.where(towards, 1.0 - np.exp(-thickness_m / _FULL_CUT_M), 0.0)
    over = cuts * share_beyond(above_m, _BLUR_M)
    # Grain that crosses the plate's line this far above the edge just clears the far corner of its end.
    struck = over - cuts * share_beyond(above_m - thickness_m * down / into, _BLUR_M)
    turned = _runs_up(arrival, towards) * (over - struck)
    on_face = minimum(arrival.landing_share, 1.0 - over) + turned
    # The end looks up the plate. Given as a speed into the face, the speed into the end has the same horizontal part.
    into_end = down * np.cos(setting.plate_angle_rad) / np.sin(setting.plate_angle_rad)
    like = np.broadcast_to(arrival.jet.mass_kg, np.broadcast_shapes(np.shape(arrival.jet.mass_kg), np.shape(on_face)))
    return Impulse(
        arrival=replace(
            arrival,
            jet=_twice(arrival.jet, like),
            from_low_edge_m=_both(arrival.from_low_edge_m, arrival.from_low_edge_m, like),
            flight_time_s=_both(arrival.flight_time_s, arrival.flight_time_s, like),
            normal_speed_m_s=_both(arrival.normal_speed_m_s, into_end, like),
            tangential_speed_m_s=_both(arrival.tangential_speed_m_s, 0.0, like),
            landing_share=_both(on_face, struck, like),
            edge_blur_m=_both(arrival.edge_blur_m, arrival.edge_blur_m, like),
        ),
        normal_gain=_both(impulse.normal_gain, impulse.normal_gain, like),
        tangential_m_s=_both(impulse.tangential_m_s, 0.0, like),
        weight=_both(impulse.weight, impulse.weight, like),
    )


EFFECT = Effect(
    name="top_edge",
    stage="impact",
    summary="Grain that flies over the plate's top edge strikes the plate's end, or is turned by the stream that runs up it.",
    signature="gain at low plate angles, where the plate's end stands in the stream; grows with what rises over it, so with "
    "load and speed; a small loss for a light stream at steep angles",
    source="the project's own discrete-element records (studies/dem, impact); by its momentum along the plate an oblique "
    "plane jet sends (1 - cos) / 2 of itself up it",
    parameters=(
        EffectParameter("thickness_m", "m", 0.0, 0.0, 0.03, 0.01, "thickness of the plate's end, grain's radius included", 0.01),
    ),
    impulse=_impulse,
    needs_misses=True,
    measured=True,
    rank=3,
)
