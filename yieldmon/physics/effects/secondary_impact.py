"""Grain that rebounds into the stream and strikes the plate again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import real, sqrt
from yieldmon.physics.stages import Impulse, Setting

from .effect import Effect, EffectParameter, Values
from .rebound import restitution, scale_restitution


def _impulse(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    arrival = impulse.arrival
    normal2 = arrival.normal_speed_m_s**2
    facing = normal2 / (normal2 + arrival.tangential_speed_m_s**2 + 1e-30)
    again = values["share"] * facing
    # The second strike cannot make the pair more than elastic: e grows towards 1.
    factor = 1.0 + again * (1.0 - restitution(impulse, setting))
    return replace(impulse, normal_gain=scale_restitution(impulse, factor, setting))


def _by_cosine(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    arrival = impulse.arrival
    normal, tangential = arrival.normal_speed_m_s, arrival.tangential_speed_m_s
    towards = real(normal) > 0.0
    length = sqrt(np.where(towards, normal * normal + tangential * tangential, 1.0))
    facing = np.where(towards, normal / length, 0.0)
    factor = 1.0 + values["share"] * facing * (1.0 - restitution(impulse, setting))
    return replace(impulse, normal_gain=scale_restitution(impulse, factor, setting))


def _within_stream(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    arrival = impulse.arrival
    normal, tangential = arrival.normal_speed_m_s, arrival.tangential_speed_m_s
    towards = real(normal) > 0.0
    drift = np.where(towards, tangential, 0.0) / np.where(towards, normal, 1.0)
    drift = np.where(real(drift) < 0.0, -drift, drift)
    stays = np.where(towards & (real(drift) < 1.0), 1.0 - drift, 0.0)
    factor = 1.0 + values["share"] * stays * (1.0 - restitution(impulse, setting))
    return replace(impulse, normal_gain=scale_restitution(impulse, factor, setting))


EFFECT = Effect(
    name="secondary_impact",
    stage="impact",
    of_grain=True,
    summary="Grain that rebounds straight back into the stream is thrown onto the plate once more.",
    signature="extra gain near normal incidence, cos^2 of the incidence; the same at every load",
    source="second collision of a share s cos^2(alpha) of the rebounding grain, bounded by elastic exchange",
    parameters=(EffectParameter("share", "", 0.0, 0.0, 1.0, 0.2, "share of rebounding grain at normal incidence", 0.4),),
    impulse=_impulse,
)

LAWS = (
    replace(
        EFFECT,
        name="secondary_impact-by_cosine",
        law="by the cosine of incidence",
        source="what rebounds straight, in proportion to its normal momentum",
        impulse=_by_cosine,
    ),
    replace(
        EFFECT,
        name="secondary_impact-within_stream",
        law="what drifts along the plate by less than it goes out",
        source="geometry: out by a stream's width, grain drifts along by tan(alpha) of it; 1 - tan(alpha) meets the stream",
        impulse=_within_stream,
    ),
)
