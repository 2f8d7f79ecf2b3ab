"""What weighed loads of trucks that two combines filled have in common: the other monitor's error, as a state of the parameters.

Each such load weighs the truck less what that monitor shows, so its error is in all of them alike: however many there are, they
know the scale no better than that monitor does. The error is a parameter of its own, whose covariance with the others goes on
from update to update; trucks of this combine alone then fix it with the scale, and from one shared truck to the next drift shows.

Source: Schmidt, "Application of state-space methods to navigation problems" (1966), on biases as further states.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.effects.other_monitor import BIAS, OTHER_MONITOR

from .parameters import ParameterSet

_SD = OTHER_MONITOR.parameters[0].prior_sd


def with_bias(known: ParameterSet) -> ParameterSet:
    """The set with the bias at its prior; a set that has the bias already is returned unchanged."""
    return known if BIAS in known.covariance_names else with_new_bias(known)


def with_new_bias(known: ParameterSet) -> ParameterSet:
    """The set with the bias as before any weighed load."""
    names = (*(name for name in known.covariance_names if name != BIAS), BIAS)
    covariance = known.covariance_of(names)
    covariance[-1, :] = covariance[:, -1] = 0.0
    covariance[-1, -1] = _SD**2
    return replace(known, values={**known.values, BIAS: 0.0}, covariance_names=names, covariance=np.asarray(covariance))
