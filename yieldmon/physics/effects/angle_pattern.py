"""What the model misses away from the home angle, as a smooth pattern over plate angle and fill with weights of its own."""

from __future__ import annotations

from dataclasses import replace
from math import radians

from yieldmon.physics.numerics import AnyArray
from yieldmon.physics.stages import Reading, Setting

from .effect import Effect, EffectParameter, Values

_HALF_RANGE_RAD = radians(25.0)
"""Half the range of a sweep."""
_FILL = 0.4
"""Fill about which the change with fill is taken."""


def _reading(reading: Reading, values: Values, setting: Setting) -> Reading:
    u = (setting.plate_angle_rad - setting.machine.home_plate_angle_rad) / _HALF_RANGE_RAD
    square = u * u
    fill = reading.impulse.arrival.jet.load.paddle_mass_kg / setting.full_paddle_mass_kg - _FILL
    pattern: AnyArray = (values["linear"] + fill * values["linear_fill"]) * u
    pattern = pattern + (values["square"] + fill * values["square_fill"]) * square
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s * (1.0 + pattern))


def _weight(name: str, what: str) -> EffectParameter:
    return EffectParameter(name, "", 0.0, -0.5, 0.5, 0.01, what, 0.01)


EFFECT = Effect(
    name="angle_pattern",
    stage="sensor",
    summary="The reading away from the home angle differs from the model's by a smooth pattern of no named cause.",
    signature="a constant pattern over plate angle and fill, 1 at the home angle; what sweeps repeat and no parameter explains",
    source="Kennedy and O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. B 63 (2001)",
    parameters=(
        _weight("linear", "relative change 25 deg away from home"),
        _weight("square", "the same, on both sides"),
        _weight("linear_fill", "its change from an empty to a full paddle"),
        _weight("square_fill", "the same, on both sides"),
    ),
    reading=_reading,
    measured=True,
    rank=3,
)
