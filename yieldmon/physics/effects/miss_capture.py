"""Grain thought to pass below the plate that strikes it all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, real
from yieldmon.physics.stages import Arrival, Setting

from .edges import landing_momentum
from .effect import Effect, EffectParameter, Values


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
)
