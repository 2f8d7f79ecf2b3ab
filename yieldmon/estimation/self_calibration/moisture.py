"""Grain parameters as a function of moisture, fitted at a few moistures; used to change a prior when the moisture changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.numerics import Array


@dataclass(frozen=True)
class MoistureMap:
    """Parameter values at known moistures, linear in between, constant outside.

    Attributes
    ----------
    moisture_pct : tuple of float
        Two or more, ascending.
    values : mapping of str to tuple of float
        Values of each parameter at these moistures, above 0.
    doubt : float
        Relative standard deviation of a predicted change, 0 or more.

    Raises
    ------
    ValueError
        For any other values.
    """

    moisture_pct: tuple[float, ...]
    values: Mapping[str, tuple[float, ...]]
    doubt: float = 0.5

    def __post_init__(self) -> None:
        if len(self.moisture_pct) < 2 or np.any(np.diff(self.moisture_pct) <= 0.0):
            raise ValueError(f"moisture map at {self.moisture_pct} %; expected two or more ascending moistures")
        for name, row in self.values.items():
            if len(row) != len(self.moisture_pct) or min(row) <= 0.0:
                raise ValueError(f"moisture map: {name} is {row}; expected {len(self.moisture_pct)} values above 0")
        if not self.doubt >= 0.0:
            raise ValueError(f"moisture map: doubt is {self.doubt}; expected 0 or more")

    def at(self, name: str, moisture_pct: float) -> float:
        """Value of a parameter at a moisture."""
        return float(np.interp(moisture_pct, self.moisture_pct, self.values[name]))

    def moved(self, parameters: ParameterSet, from_pct: float, to_pct: float) -> ParameterSet:
        """The prior for grain at moisture to_pct, from the parameters of grain at from_pct.

        Each parameter in the map, and its standard deviation, is multiplied by the map's ratio, and the uncertainty of the change
        is added. Others stay the same. Moistures outside the map are clamped to its ends.
        """
        ratios = {n: self.at(n, to_pct) / self.at(n, from_pct) for n in self.values if n in parameters.values}
        if all(r == 1.0 for r in ratios.values()):
            return parameters
        values = {n: v * ratios.get(n, 1.0) for n, v in parameters.values.items()}
        names = parameters.covariance_names
        scale = np.array([ratios.get(n, 1.0) for n in names])
        extra: Array = np.array([(self.doubt * (values[n] - parameters.values[n])) ** 2 for n in names])
        return replace(parameters, values=values, covariance=parameters.covariance * np.outer(scale, scale) + np.diag(extra))


def fit(moisture_pct: Sequence[float], sets: Sequence[ParameterSet], doubt: float = 0.5) -> MoistureMap:
    """A map from calibrations at several moistures, with the parameters that are fitted and above 0 in all of them.

    Raises ValueError if there are fewer than two calibrations, or no parameter is common to all.
    """
    order = np.argsort(moisture_pct)
    shared = [n for n in sets[0].covariance_names if all(n in s.covariance_names and s.values[n] > 0.0 for s in sets)]
    if not shared:
        raise ValueError("the calibrations have no fitted parameter above 0 in common")
    return MoistureMap(
        tuple(float(moisture_pct[i]) for i in order),
        {n: tuple(float(sets[i].values[n]) for i in order) for n in shared},
        doubt,
    )
