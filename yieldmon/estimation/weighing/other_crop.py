"""Prior for a crop from the weighed loads of another crop on the same machine, before any of its own is weighed.

Density and impact gain are off the published ones by what the machine does to all grain (its geometry, its plate, grain that
strikes grain), and so is the curve of the force over the load. Both go over to the other crop; what differs between crops beside
their published properties is an error of the scale (`parameters.CARRIED_SD`) and of the curve.
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
"""Of the pattern's weights, by what differs between crops: studies/crop_change."""


def carried(published: ParameterSet, weighed: ParameterSet, before: ParameterSet, crop: str) -> ParameterSet | None:
    """Parameters of a crop with scale and curve as another one's weighed loads have them.

    Parameters
    ----------
    published : ParameterSet
        Of the crop, by its published properties.
    weighed : ParameterSet
        Of the other crop, whose scale weighed loads or kernel noise have set.
    before : ParameterSet
        Of the other crop, by its published properties.
    crop : str
        Name of the other crop.

    Returns
    -------
    ParameterSet or None
        Density and gain by the ratio of `weighed` to `before`, friction as published, the weights of `load_pattern` as weighed;
        with the provenance of which `ParameterSet.scale_error` speaks. None where the sets differ in more than that.
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
    """Density and impact gain."""
    gain = gain_names(known)[-1]
    return np.array([known.values[DENSITY], known.values[gain] + (1.0 if gain == "restitution" else 0.0)])


def _relative(covariance: Array, sizes: Array) -> Array:
    """The covariance of density, gain and further numbers with the first two in other units. sizes: of one in the other."""
    scales = np.concatenate((sizes, np.ones(len(covariance) - 2)))
    return np.asarray(covariance * np.outer(scales, scales))
