"""Grain that leaves in a fan instead of along one path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, arctan, erf, exp, maximum, real, sin_cos, sqrt
from yieldmon.physics.stages import Arrival, Setting

from .effect import Effect, EffectParameter, Values

_FAR = 7.0
"""Standard deviations beyond which the low edge no longer cuts the fan (1e-12 of the grain)."""
_LEAST_SHARE = 1e-9
"""Share of the fan between the edges below which none is taken to land."""


def _gaussian(edge: AnyArray, spread: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Share, mean and variance of what lies below `edge` of a normal distribution of directions."""
    z = _standard(edge / spread)
    lands = 0.5 * (1.0 + erf(z / np.sqrt(2.0)))
    hazard = exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) / lands
    return lands, -spread * hazard, spread * spread * (1.0 - z * hazard - hazard * hazard)


def _between(top: AnyArray, edge: AnyArray, spread: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """The same of what lies above `top` as well; a share below 1e-9 has the mean of the nearer bound."""
    high, low = _standard(edge / spread), _standard(top / spread)
    lands = 0.5 * (erf(high / np.sqrt(2.0)) - erf(low / np.sqrt(2.0)))
    some = real(lands) > _LEAST_SHARE
    share = np.where(some, lands, 1.0)
    at_high, at_low = (exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) for z in (high, low))
    shift = np.where(some, (at_low - at_high) / share, 0.0)
    narrower = np.where(some, (high * at_high - low * at_low) / share, 1.0)
    return np.where(some, lands, 0.0), spread * shift, spread * spread * (1.0 - narrower - shift * shift)


def _standard(z: AnyArray) -> AnyArray:
    bounded: AnyArray = np.where(real(z) > _FAR, _FAR, np.where(real(z) < -_FAR, -_FAR, z))
    return bounded


def _to_edge(arrival: Arrival, setting: Setting, length_m: float) -> AnyArray:
    """By how much a path must be turned at the tip, towards the low edge, to end `length_m` below the plate's top edge."""
    jet, length = arrival.jet, length_m
    sin, cos = sin_cos(setting.plate_angle_rad)
    x = setting.plate_pivot_x_m + length * cos - jet.x_m
    y = setting.plate_pivot_y_m + length * sin - jet.y_m
    g = 0.0 if setting.gravity_m_s2 is None else setting.gravity_m_s2
    drop = 0.5 * g * x * x / (jet.vx_m_s**2 + jet.vy_m_s**2)
    root = sqrt(maximum(x * x - 4.0 * drop * (drop - y), np.asarray(1e-9)))
    return arctan(2.0 * (y - drop) / (x + root)) - arctan(jet.vy_m_s / jet.vx_m_s)


def _arrival(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    return _fanned(arrival, values, setting, both=False)


def _both_edges(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    return _fanned(arrival, values, setting, both=True)


def _fanned(arrival: Arrival, values: Values, setting: Setting, *, both: bool) -> Arrival:
    spread = values["spread_rad"]
    meets = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    fans_out = real(spread) > 0.0
    normal = np.where(meets, arrival.normal_speed_m_s, 1.0)
    tangential = np.where(meets, arrival.tangential_speed_m_s, 0.0)
    speed = sqrt(normal * normal + tangential * tangential)
    incidence = arctan(tangential / normal)
    edge, width = _to_edge(arrival, setting, setting.machine.plate_length_m), np.where(fans_out, spread, 1.0)
    # What lands is turned towards the middle of what the edges leave.
    lands, turn, variance = _between(_to_edge(arrival, setting, 0.0), edge, width) if both else _gaussian(edge, width)
    kept = speed * exp(-0.5 * variance)
    sin, cos = sin_cos(incidence + turn)
    fan = meets & fans_out
    # The series of which this is the start may pass a right angle where next to nothing lands.
    into = maximum(kept * cos, np.asarray(1e-9))
    return replace(
        arrival,
        landing_share=np.where(fans_out, np.where(meets, lands, 0.0), arrival.landing_share),
        normal_speed_m_s=np.where(fan, into, arrival.normal_speed_m_s),
        tangential_speed_m_s=np.where(fan, kept * sin, arrival.tangential_speed_m_s),
    )


EFFECT = Effect(
    name="stream_spread",
    stage="flight",
    summary="Grain leaves the tip in a fan of directions, so that the plate's low edge cuts it softly.",
    signature="smeared low edge: gain at low plate angles where grain misses, loss where it hits; a uniform loss of s^2/2",
    source="Gaussian fan of directions about the path of [8.17], cut by the plate's low edge; moments of a truncated normal",
    parameters=(EffectParameter("spread_rad", "rad", 0.0, 0.0, 0.5, 0.1, "standard deviation of direction", 0.15),),
    arrival=_arrival,
    needs_misses=True,
    rank=1,
)

LAWS = (
    replace(
        EFFECT,
        name="stream_spread-both_edges",
        law="cut by the plate's top edge as well as by the low one",
        source="moments of a normal distribution truncated at both ends: Johnson, Kotz and Balakrishnan, Continuous Univariate "
        "Distributions 1 (1994), chapter 13",
        arrival=_both_edges,
    ),
)
