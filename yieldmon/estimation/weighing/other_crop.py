"""Prior for a crop that has no weighed load yet, from the weighed loads of another crop on the same machine.

Density, impact gain and the curve of force over load differ from the published ones by effects that the machine has on all grain
(geometry, plate, collisions between grains). These corrections are applied to the new crop. Differences between crops that their
published properties do not contain are counted as an error of the scale (`parameters.CARRIED_SD`) and of the curve.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from yieldmon.estimation.load_pattern import EFFECT, NAMES
from yieldmon.estimation.parameters import CARRIED, CARRIED_FROM, SCALE, ParameterSet
from yieldmon.physics.numerics import Array

from .density_and_gain import DENSITY, gain_names, moved

_CURVE_SD = 0.05
"""Standard deviation of the pattern's weights by differences between crops: studies/crop_change."""


def carried(published: ParameterSet, weighed: ParameterSet, before: ParameterSet, crop: str) -> ParameterSet | None:
    """Parameters of a crop with the scale and curve that another crop's weighed loads have determined.

    Parameters
    ----------
    published : ParameterSet
        The crop's parameters from its published properties.
    weighed : ParameterSet
        The other crop's parameters, calibrated by weighed loads or kernel noise.
    before : ParameterSet
        The other crop's parameters from its published properties.
    crop : str
        Name of the other crop.

    Returns
    -------
    ParameterSet or None
        Density and gain multiplied by the ratio of `weighed` to `before`, friction as published, weights of `load_pattern` from
        `weighed`, and the provenance that `ParameterSet.scale_error` reads. None if the sets differ in more than that.
    """
    if weighed.curve is not None or set(weighed.effects) - {EFFECT} != set(published.effects) or weighed.values.get("k1"):
        return None
    weights = tuple(name for name in NAMES if name in weighed.values)
    names, size = (DENSITY, gain_names(weighed)[-1], *weights), _sizes(weighed)
    shown = _relative(weighed.covariance_of(names), 1.0 / size)
    shown[2:, 2:] += _CURVE_SD**2 * np.eye(len(weights))
    there = moved(published, *np.log(size / _sizes(before)).tolist())
    held = tuple(name for name in published.covariance_names if name not in (DENSITY, *gain_names(published)))
    covariance = block_diag(published.covariance_of(held), _relative(shown, _sizes(there)))
    return replace(
        there,
        values={**there.values, **{name: weighed.values[name] for name in weights}},
        covariance_names=(*held, DENSITY, gain_names(there)[-1], *weights),
        covariance=covariance,
        provenance={**published.provenance, SCALE: CARRIED, CARRIED_FROM: crop},
    )


def _sizes(known: ParameterSet) -> Array:
    """Density, and impact gain (1 + restitution, or k2)."""
    gain = gain_names(known)[-1]
    return np.array([known.values[DENSITY], known.values[gain] + (1.0 if gain == "restitution" else 0.0)])


def _relative(covariance: Array, sizes: Array) -> Array:
    """The covariance of (density, gain, further parameters) with the first two multiplied by `sizes`, (2,)."""
    scales = np.concatenate((sizes, np.ones(len(covariance) - 2)))
    return np.asarray(covariance * np.outer(scales, scales))
