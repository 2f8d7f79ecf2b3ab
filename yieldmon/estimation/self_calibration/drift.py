"""Drift between calibrations: the parameters' uncertainty grows with time and with harvested mass.

Random walks: variances grow in proportion to hours and to harvested mass, up to those without any calibration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from yieldmon.estimation.fitting.identifiability import natural_scale
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.grain import drift_key

from .drift_rates import KG_PER_KT, DriftRates


def grow(parameters: ParameterSet, rates: DriftRates, hours: float, harvested_kg: float) -> ParameterSet:
    """The same values with their covariance after `hours` and `harvested_kg`. k1 and k2 have the rates of restitution.

    Correlations from earlier sweeps fade as the variances grow. Raises ValueError for negative amounts.
    """
    if hours < 0.0 or harvested_kg < 0.0:
        raise ValueError(f"drift over {hours} h and {harvested_kg} kg; expected 0 or more of each")
    names = parameters.covariance_names
    added = np.zeros(len(names))
    for i, name in enumerate(names):
        key = drift_key(name)
        size = natural_scale(name, parameters.values[name]) ** 2
        growth = size * (
            rates.per_root_hour.get(key, 0.0) ** 2 * hours
            + rates.per_root_kilotonne.get(key, 0.0) ** 2 * harvested_kg / KG_PER_KT
        )
        room = size * rates.limit.get(key, np.inf) ** 2 - parameters.covariance[i, i]
        added[i] = min(growth, max(room, 0.0))
    return replace(parameters, covariance=parameters.covariance + np.diag(added))


def by_change(parameters: ParameterSet, std_dev: Mapping[str, float]) -> ParameterSet:
    """The same values with their covariance after changes of these standard deviations, each in its parameter's unit and
    independent of the others.

    Raises ValueError for a parameter without a variance, and for a standard deviation that is not above 0.
    """
    names = parameters.covariance_names
    for name, sd in std_dev.items():
        if name not in names:
            raise ValueError(f"{name} is not a parameter with a variance; expected one of {', '.join(names)}")
        if not 0.0 < sd < np.inf:
            raise ValueError(f"{name} is {sd:g}; expected a number above 0")
    added = np.diag([std_dev.get(name, 0.0) ** 2 for name in names])
    return replace(parameters, covariance=parameters.covariance + added)
