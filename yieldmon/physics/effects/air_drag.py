"""Air that brakes the grain in flight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, exp, real
from yieldmon.physics.stages import Arrival, Setting

from .effect import Effect, EffectParameter, Values


def _arrival(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    return _slowed(arrival, values["rate_per_m"], arrival.flight_length_m)


def _by_time(arrival: Arrival, values: Values, setting: Setting) -> Arrival:
    return _slowed(arrival, values["rate_per_s"], arrival.flight_time_s)


def _slowed(arrival: Arrival, rate: AnyArray, flight: AnyArray) -> Arrival:
    """Speeds times exp(-rate flight), with flight its length or time; unchanged where that is not finite or not positive."""
    known = np.where(np.isfinite(real(flight)), flight, 0.0)
    kept = exp(-rate * np.where(real(known) > 0.0, known, 0.0))
    return replace(
        arrival,
        normal_speed_m_s=arrival.normal_speed_m_s * kept,
        tangential_speed_m_s=arrival.tangential_speed_m_s * kept,
    )


EFFECT = Effect(
    name="air_drag",
    stage="flight",
    of_grain=True,
    summary="Quadratic drag takes a fixed share of the speed per metre of flight.",
    signature="loss of exp(-g L / v_t^2): longer paths, to a steep plate, lose more; no change with speed",
    source="quadratic drag, dv/ds = -(g / v_t^2) v; terminal speeds of grain: Mohsenin, Physical Properties of Plant and "
    "Animal Materials",
    parameters=(EffectParameter("rate_per_m", "1/m", 0.0, 0.0, 0.6, 0.08, "g over the terminal speed squared", 0.2),),
    arrival=_arrival,
)

LAWS = (
    replace(
        EFFECT,
        name="air_drag-by_time",
        law="in proportion to speed: a fixed share a second",
        source="Stokes's limit; a loose stream that carries its air along",
        parameters=(EffectParameter("rate_per_s", "1/s", 0.0, 0.0, 4.0, 0.5, "share of its speed lost a second", 1.2),),
        arrival=_by_time,
    ),
)
