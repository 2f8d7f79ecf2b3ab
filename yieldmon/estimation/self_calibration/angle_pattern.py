"""The model's own error over plate angle and fill as an estimated state.

If the model were assumed exact, a sweep would turn its error at 40 degrees into a wrong friction. Here the error is described by
the weights of the effect `angle_pattern`, which have their own prior and a covariance that is kept from sweep to sweep. What is
the same in all sweeps is attributed to the pattern, and what changes between them to the grain. The pattern is 0 at the home
angle at every fill, so that it cannot absorb what a calibration at home determines.

Sources: Kennedy and O'Hagan, J. R. Stat. Soc. B 63 (2001); Brynjarsdottir and O'Hagan, Inverse Problems 30 (2014), on why such a
term needs a prior.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.estimation.model_error import FLOOR
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.effects import angle_pattern

EFFECT = angle_pattern.EFFECT.name
NAMES = tuple(f"{EFFECT}.{parameter.name}" for parameter in angle_pattern.EFFECT.parameters)
_CALIBRATED = 2.0
"""Ratio of the pattern's size beyond the calibrated angles to the model's error within them."""


def with_pattern(parameters: ParameterSet, relative_sd: float) -> ParameterSet:
    """The set with the pattern at its prior; a set that has a pattern already is returned unchanged.

    Parameters
    ----------
    parameters : ParameterSet
        The pattern's prior is wider if its `model_error`, estimated from held-out angles and loads, is large.
    relative_sd : float
        Standard deviation of the relative error 25 degrees from home; at least `model_error.FLOOR`.

    Returns
    -------
    ParameterSet
    """
    if EFFECT in parameters.effects:
        return parameters
    size = max(relative_sd, _CALIBRATED * (parameters.model_error or 0.0), FLOOR)
    count = len(parameters.covariance_names)
    covariance = np.zeros((count + len(NAMES),) * 2)
    covariance[:count, :count] = parameters.covariance
    covariance[count:, count:] = size**2 * np.eye(len(NAMES))
    return replace(
        parameters,
        values={**parameters.values, **dict.fromkeys(NAMES, 0.0)},
        covariance_names=(*parameters.covariance_names, *NAMES),
        covariance=covariance,
    )


def without_pattern(parameters: ParameterSet) -> ParameterSet:
    """The set without the pattern."""
    if EFFECT not in parameters.effects:
        return parameters
    kept = tuple(name for name in parameters.covariance_names if name not in NAMES)
    return replace(
        parameters,
        values={name: value for name, value in parameters.values.items() if name not in NAMES},
        covariance_names=kept,
        covariance=parameters.covariance_of(kept),
    )
