"""Grain that leaves in a fan instead of along one path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, arctan, erf, exp, maximum, real, sin_cos, sqrt
from yieldmon.physics.stages import Arrival, Setting

from .effect import Effect, EffectParameter, Values, where_restitution

_FAR = 7.0
"""Standard deviations beyond which the low edge no longer cuts the fan (1e-12 of the grain)."""
_LEAST_SHARE = 1e-9
"""Share of the fan between the edges below which none is taken to land."""
Landing = Callable[[AnyArray], tuple[AnyArray, AnyArray, AnyArray]]
"""Share, mean and variance of the directions that land, of a fan of that standard deviation."""


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


def even_and_normal(edge: AnyArray, spread: AnyArray, evenness: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Share, mean and variance of what lies below `edge` of directions that are the sum of an even and a normal one.

    evenness: share of the variance, spread squared, that the even one has. Where a share below 1e-9 lands, the edge is its mean.
    """
    half, soft = spread * sqrt(3.0 * evenness), spread * sqrt(1.0 - evenness)
    reach = half + _FAR * soft
    t: AnyArray = np.where(real(edge) > real(reach), reach, np.where(real(edge) < -real(reach), -reach, edge))
    high, low = (t + half) / soft, (t - half) / soft
    first, second, third = (a - b for a, b in zip(_integrals(high), _integrals(low), strict=True))
    unit = soft / (2.0 * half)
    lands, once, twice = unit * first, unit * soft * second, unit * soft * soft * third
    some = real(lands) > _LEAST_SHARE
    share = np.where(some, lands, 1.0)
    # By parts: the mean of what lands is the edge less once / lands.
    below = once / share
    variance = 2.0 * twice / share - below * below
    return np.where(some, lands, 0.0), np.where(some, t - below, t), np.where(some, variance, 0.0)


def _integrals(z: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """The first three repeated integrals of the normal distribution function, from minus infinity."""
    below = 0.5 * (1.0 + erf(z / np.sqrt(2.0)))
    at = exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
    square = z * z
    return z * below + at, 0.5 * ((square + 1.0) * below + z * at), ((square + 3.0) * z * below + (square + 2.0) * at) / 6.0


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
    edge = _to_edge(arrival, setting, setting.machine.plate_length_m)
    return _fanned(arrival, values["spread_rad"], lambda spread: _gaussian(edge, spread))


def _both_edges(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    edge, top = (_to_edge(arrival, setting, length_m) for length_m in (setting.machine.plate_length_m, 0.0))
    return _fanned(arrival, values["spread_rad"], lambda spread: _between(top, edge, spread))


@where_restitution
def _evenly(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    edge = _to_edge(arrival, setting, setting.machine.plate_length_m)
    return _fanned(arrival, values["spread_rad"], lambda spread: even_and_normal(edge, spread, values["evenness"]))


def _fanned(arrival: Arrival, spread: AnyArray, landing: Landing) -> Arrival:
    meets = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    fans_out = real(spread) > 0.0
    normal = np.where(meets, arrival.normal_speed_m_s, 1.0)
    tangential = np.where(meets, arrival.tangential_speed_m_s, 0.0)
    speed = sqrt(normal * normal + tangential * tangential)
    incidence = arctan(tangential / normal)
    # What lands is turned towards the middle of what the edges leave.
    lands, turn, variance = landing(np.where(fans_out, spread, 1.0))
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
        # What the top edge cuts is stream_rise, for which this law stood with a spread of hardly anything.
        searched=False,
    ),
    replace(
        EFFECT,
        name="stream_spread-even",
        law="evenly over a range of directions with soft ends; where the impact's gain is 1 + restitution",
        source="between a stream whose layers leave in directions that differ evenly, and a normal fan: the sum of an even and a "
        "normal direction",
        parameters=(
            *EFFECT.parameters,
            EffectParameter("evenness", "", 0.5, 0.05, 0.98, 0.3, "share of the variance that the even part has", 0.8),
        ),
        arrival=_evenly,
    ),
)
