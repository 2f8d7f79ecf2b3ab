"""Grain that passes over the plate's top edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import exp, maximum, real
from yieldmon.physics.stages import Arrival, Setting

from .effect import Effect, EffectParameter, Values

_EDGE_M = 0.005
"""About one kernel: the sharpest edge that a stream of grain can see."""


def _arrival(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    kappa = np.where(np.isfinite(real(arrival.from_low_edge_m)), arrival.from_low_edge_m, 0.0)
    below_top = maximum(kappa + setting.machine.plate_length_m, np.asarray(0.0))
    depth = values["depth_m"]
    return replace(arrival, landing_share=arrival.landing_share * (1.0 - depth / (depth + _EDGE_M + below_top)))


def _exponential(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    kappa = np.where(np.isfinite(real(arrival.from_low_edge_m)), arrival.from_low_edge_m, 0.0)
    below_top = maximum(kappa + setting.machine.plate_length_m, np.asarray(0.0))
    depth = values["depth_m"]
    cleared = exp(-below_top / (depth + _EDGE_M)) * depth / (depth + _EDGE_M)
    return replace(arrival, landing_share=arrival.landing_share * (1.0 - cleared))


EFFECT = Effect(
    name="plate_overshoot",
    stage="flight",
    summary="The outer part of the stream passes over the plate's top edge.",
    signature="loss that falls with distance from the top edge: most for light loads, whose grain all lands near the top",
    source="geometry: the first grain leaves level with the plate's top edge, and a stream has depth",
    parameters=(EffectParameter("depth_m", "m", 0.0, 0.0, 0.1, 0.01, "depth of stream that clears the edge", 0.01),),
    arrival=_arrival,
)

LAWS = (
    replace(
        EFFECT,
        name="plate_overshoot-exponential",
        law="a stream whose outer part thins out exponentially",
        source="depth of a free surface of random height",
        arrival=_exponential,
    ),
)
