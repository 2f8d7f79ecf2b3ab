"""Grain whose friction, restitution and density follow its moisture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import minimum, real
from yieldmon.physics.stages import Setting

from .effect import Effect, EffectParameter, Values

REFERENCE_PCT = 15.0
"""Moisture at which the grain's own parameters are given."""


def _setting(setting: Setting, values: Values) -> Setting:
    if np.any(np.isnan(real(setting.moisture_pct))):
        raise ValueError("moisture_dependence: the moisture is unknown; expected a moisture in % for every condition")
    wetter = setting.moisture_pct - REFERENCE_PCT
    friction = setting.friction * np.exp(values["friction_per_pct"] * wetter)
    density = setting.density * np.exp(values["density_per_pct"] * wetter)
    if setting.restitution is not None:
        restitution = minimum(setting.restitution * np.exp(values["restitution_per_pct"] * wetter), np.asarray(1.0))
        return replace(setting, friction=friction, density=density, restitution=restitution)
    gain = np.exp(values["restitution_per_pct"] * wetter)
    assert setting.k1 is not None
    assert setting.k2 is not None
    return replace(setting, friction=friction, density=density, k1=setting.k1 * gain, k2=setting.k2 * gain)


EFFECT = Effect(
    name="moisture_dependence",
    stage="crop",
    of_grain=True,
    summary="Wetter grain rubs more, rebounds less and packs differently.",
    signature="friction, gain and density drift together with moisture; nothing at 15 %",
    source="ASAE D241 (density and moisture); Mohsenin, Physical Properties of Plant and Animal Materials (friction)",
    parameters=(
        EffectParameter("friction_per_pct", "1/%", 0.0, -0.02, 0.15, 0.03, "relative change of friction", 0.04),
        EffectParameter("density_per_pct", "1/%", 0.0, -0.05, 0.05, 0.01, "relative change of density", -0.008),
        EffectParameter(
            "restitution_per_pct", "1/%", 0.0, -0.1, 0.05, 0.02, "relative change of restitution, or of the gain", -0.02
        ),
    ),
    setting=_setting,
    needs_moisture=True,
)
