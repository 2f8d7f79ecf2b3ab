"""The effect `load_pattern` in a parameter set: weighed loads may put it there, whatever effects the model was made with."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.effects import load_pattern
from yieldmon.physics.model import ForwardModel

from .parameters import ParameterSet

EFFECT = load_pattern.EFFECT.name
NAMES = tuple(f"{EFFECT}.{parameter.name}" for parameter in load_pattern.EFFECT.parameters)

_SURE = 2.5
"""Standard deviations from nought beyond which a weight is no chance."""


def with_weights(known: ParameterSet) -> ParameterSet:
    """The set with the pattern's weights among its values, 0 where it has none; its covariance as it was."""
    missing = {name: 0.0 for name in NAMES if name not in known.values}
    return replace(known, values={**known.values, **missing}) if missing else known


def following(model: ForwardModel, known: ParameterSet) -> ForwardModel:
    """The model with the pattern where the set has weights for it, and without it where it has none."""
    has, wants = EFFECT in model.effects, EFFECT in known.effects
    if has == wants:
        return model
    return model.with_effects((*model.effects, EFFECT) if wants else [name for name in model.effects if name != EFFECT])


def another_curve(known: ParameterSet) -> bool:
    """Whether the pattern over the load is more than its standard deviations leave to chance."""
    return any(
        abs(known.values[name]) > _SURE * known.standard_deviation(name)
        for name in (f"{EFFECT}.exponent", f"{EFFECT}.bend")
        if known.values.get(name, 0.0) != 0.0
    )
