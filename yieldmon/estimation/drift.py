"""Drift between calibrations: what was known grows stale with time and with grain that has passed.

Random walks: variances grow in proportion to hours and to harvested mass, up to what one knows without any calibration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from yieldmon.physics.grain import DRIFTING, GRAIN, drift_key

from .identifiability import natural_scale
from .parameters import ParameterSet

_WEAR_UNIT_KG = 1e6


@dataclass(frozen=True)
class DriftRates:
    """Growth of relative standard deviations, by parameter (1 + restitution stands for restitution); absent: no drift.

    per_root_hour: after one hour; per_root_kilotonne: after 1000 t of grain. limit: relative standard deviation at which growth
    ends. Raises ValueError for a negative rate.
    """

    per_root_hour: Mapping[str, float] = field(default_factory=lambda: _defaults("per_root_hour"))
    per_root_kilotonne: Mapping[str, float] = field(default_factory=lambda: _defaults("per_root_kilotonne"))
    limit: Mapping[str, float] = field(default_factory=lambda: _defaults("limit"))

    def __post_init__(self) -> None:
        for rates in (self.per_root_hour, self.per_root_kilotonne, self.limit):
            for name, rate in rates.items():
                if not rate >= 0.0:
                    raise ValueError(f"drift rate of {name} is {rate}; expected 0 or more")


def _defaults(rate: str) -> dict[str, float]:
    return {name: getattr(GRAIN[name].drift, rate) for name in DRIFTING}


def steady_defaults() -> dict[str, float]:
    """Likely sizes of steady drift per kilotonne; 0: none is looked for."""
    return _defaults("steady_per_kilotonne")


def grow(parameters: ParameterSet, rates: DriftRates, hours: float, harvested_kg: float) -> ParameterSet:
    """The same values with the covariance that they have `hours` and `harvested_kg` later. k1 and k2 share restitution's rates.

    Correlations made by earlier sweeps fade as the variances grow. Raises ValueError for negative amounts.
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
            + rates.per_root_kilotonne.get(key, 0.0) ** 2 * harvested_kg / _WEAR_UNIT_KG
        )
        room = size * rates.limit.get(key, np.inf) ** 2 - parameters.covariance[i, i]
        added[i] = min(growth, max(room, 0.0))
    return replace(parameters, covariance=parameters.covariance + np.diag(added))
