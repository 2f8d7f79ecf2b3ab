"""An effect from outside the package: a damp plate takes up a share of every impact.

`pip install .` here makes it known by its entry point: `yieldmon predict --set damp_plate.loss=0.1 ...`,
and to calibration and diagnosis as well. yieldmon tries it first: its null values must change nothing, and its hooks
take arrays of complex numbers too, by which derivatives are taken (no abs, maximum or clip of a parameter).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from yieldmon.api import Effect, EffectParameter


def _impulse(impulse: Any, values: Mapping[str, Any], setting: Any) -> Any:
    return replace(impulse, weight=impulse.weight * (1.0 - values["loss"]))


EFFECT = Effect(
    name="damp_plate",
    stage="impact",
    summary="A damp plate takes up a share of every impact.",
    signature="a loss that is the same at every angle and load",
    source="an example",
    parameters=(EffectParameter("loss", "", 0.0, 0.0, 0.5, 0.1, "share of the impulse that is lost", 0.1),),
    impulse=_impulse,
)
