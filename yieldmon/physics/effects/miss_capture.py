"""Grain thought to pass below the plate that strikes it all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import real
from yieldmon.physics.stages import Arrival, Setting

from .effect import Effect, EffectParameter, Values


def _arrival(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    towards = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    missing = 1.0 - arrival.landing_share
    return replace(arrival, landing_share=arrival.landing_share + np.where(towards, values["share"] * missing, 0.0))


EFFECT = Effect(
    name="miss_capture",
    stage="flight",
    summary="Grain on paths below the plate's low edge is carried onto the plate by the stream above it.",
    signature="more at low plate angles and large loads; the angle profile no longer depends on the load",
    source="dense granular jets deflect as a whole: Cheng et al., Physical Review Letters 99, 188001 (2007)",
    parameters=(EffectParameter("share", "", 0.0, 0.0, 1.0, 0.3, "share of the missing grain that hits", 0.4),),
    arrival=_arrival,
    needs_misses=True,
)
