"""Grain thought to pass below the plate that strikes it all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, exp, maximum, real
from yieldmon.physics.stages import Arrival, Reading, Setting

from .edges import landing_momentum
from .effect import Effect, EffectParameter, Values, where_restitution
from .rebound import NOMINAL_RESTITUTION


def _towards_low_edge(arrival: Arrival, towards: AnyArray) -> AnyArray:
    """Share of its momentum with which the stream on the plate runs towards the low edge: the cosine of its incidence, or 0."""
    into, along = landing_momentum(arrival, towards)
    runs = (real(into) > 0.0) & (real(along) > 0.0)
    share: AnyArray = np.where(runs, along / np.sqrt(np.where(runs, into * into + along * along, 1.0)), 0.0)
    return share


def _arrival(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    towards = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    missing = 1.0 - arrival.landing_share
    caught = values["share"] * _towards_low_edge(arrival, towards)
    return replace(arrival, landing_share=arrival.landing_share + np.where(towards, caught * missing, 0.0))


def _any_incidence(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    towards = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    missing = 1.0 - arrival.landing_share
    return replace(arrival, landing_share=arrival.landing_share + np.where(towards, values["share"] * missing, 0.0))


def _near_edge(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    towards = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    reach = values["reach_m"]
    reaches = real(reach) > 0.0
    below = maximum(np.where(towards, arrival.from_low_edge_m, 0.0), np.asarray(0.0))
    caught = np.where(towards & reaches, exp(-below / np.where(reaches, reach, 1.0)), 0.0)
    return replace(arrival, landing_share=arrival.landing_share + caught * (1.0 - arrival.landing_share))


@where_restitution
def _fading(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    towards = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    below = maximum(np.where(towards, arrival.from_low_edge_m, 0.0), np.asarray(0.0))
    caught = np.where(towards, values["share"] * exp(-below / values["reach_m"]), 0.0)
    return replace(arrival, landing_share=arrival.landing_share + caught * (1.0 - arrival.landing_share))


def _arrested(reading: Reading, values: Values, setting: Setting) -> Reading:
    impulse = reading.impulse
    arrival = impulse.arrival
    towards = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    below = towards & (real(arrival.from_low_edge_m) > -0.5 * setting.machine.plate_length_m)
    sin, cos = np.sin(setting.plate_angle_rad), np.cos(setting.plate_angle_rad)
    forward = np.where(below, arrival.normal_speed_m_s * sin + arrival.tangential_speed_m_s * cos, 0.0)
    # Without rebound, in the unit that exchange coefficients may carry.
    unit = 1.0 if setting.restitution is not None else impulse.normal_gain / (1.0 + NOMINAL_RESTITUTION)
    missing = np.where(below, (1.0 - arrival.landing_share) * arrival.jet.mass_kg, 0.0)
    given = np.sum(missing * forward * unit, axis=-1, keepdims=True)
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s + values["share"] * given)


EFFECT = Effect(
    name="miss_capture",
    stage="flight",
    of_grain=True,
    summary="Grain on paths below the plate's low edge is turned by the stream that runs down the plate.",
    signature="more at low plate angles, where the stream runs down the plate, and at large loads; nothing at normal incidence",
    source="dense granular jets deflect as a whole: Cheng et al., Physical Review Letters 99, 188001 (2007); by the cosine of "
    "incidence: the project's own discrete-element records (studies/dem, flight)",
    parameters=(EffectParameter("share", "", 0.0, 0.0, 1.0, 0.3, "share of missing grain that hits, at grazing incidence", 0.4),),
    arrival=_arrival,
    needs_misses=True,
)

LAWS = (
    replace(
        EFFECT,
        name="miss_capture-any_incidence",
        law="the same share of what misses, whatever the incidence",
        source="limit of a thick stream that carries along all that it meets",
        arrival=_any_incidence,
    ),
    replace(
        EFFECT,
        name="miss_capture-near_edge",
        law="what passes close below the low edge, fading with distance",
        source="a jet's own depth on the plate, its free surface thinning out exponentially",
        parameters=(EffectParameter("reach_m", "m", 0.0, 0.0, 0.3, 0.05, "distance below the edge at which 1/e hits", 0.05),),
        arrival=_near_edge,
    ),
    replace(
        EFFECT,
        name="miss_capture-arrested",
        law="what misses is stopped by the stream on the plate: it gives up its horizontal momentum and does not rebound",
        source="plastic limit of impact on a dense jet: Cheng et al., Physical Review Letters 99, 188001 (2007)",
        parameters=(EffectParameter("share", "", 0.0, 0.0, 1.0, 0.3, "share of missing grain that is stopped", 0.4),),
        arrival=None,
        reading=_arrested,
    ),
    replace(
        EFFECT,
        name="miss_capture-fading",
        law="a share of what passes below the low edge, fading with distance; where the impact's gain is 1 + restitution",
        source="between a jet that carries along all that it meets, and one whose free surface thins out exponentially",
        parameters=(
            EffectParameter("share", "", 0.0, 0.0, 1.0, 0.3, "share that hits of what passes just below the edge", 0.4),
            EffectParameter("reach_m", "m", 0.1, 0.02, 1.0, 0.2, "distance below the edge over which it falls by 1/e", 0.2),
        ),
        arrival=_fading,
    ),
)
