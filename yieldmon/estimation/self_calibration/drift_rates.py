"""Drift rates of the parameters, as in a configuration; the defaults come from the registry of grain parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from yieldmon.physics.grain import DRIFTING, GRAIN

KG_PER_KT = 1e6


@dataclass(frozen=True)
class DriftRates:
    """Growth of relative standard deviations by parameter; a parameter without an entry does not drift.

    Restitution's deviations are relative to 1 + restitution.

    Attributes
    ----------
    per_root_hour : mapping of str to float
        After one hour, whether harvesting or not.
    per_root_kilotonne : mapping of str to float
        After 1000 t of grain.
    limit : mapping of str to float
        Relative standard deviation at which growth ends.

    Raises
    ------
    ValueError
        For a negative rate.
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


STEADY_MEMORY_KT = 2.0
"""Harvested mass over which a steady rate falls to 1/e of itself, kt: some days of harvest."""


def steady_defaults() -> dict[str, float]:
    """Expected sizes of steady drift per kilotonne by parameter; 0: no steady drift is estimated."""
    return _defaults("steady_per_kilotonne")
