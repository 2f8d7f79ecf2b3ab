"""What is known before the data: physical bounds, start ranges and Gaussian priors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.physics.effects import effect_parameter, get_effect
from yieldmon.physics.grain import GRAIN, GrainParameter
from yieldmon.physics.numerics import Array

from .parameters import ParameterSet

Bounds = Mapping[str, tuple[float, float]]


def follows_scale(name: str) -> bool:
    """Whether a parameter is in the reading's own unit, so that it scales with it."""
    if "." in name:
        return get_effect(name.partition(".")[0]).unit_follows_response
    return _grain(name).follows_response


def stretch(name: str, scale: float) -> float:
    """Factor of a parameter's bounds and sizes where the reading has `scale` units in one kg m/s: 1 unless it follows the scale,
    1 / scale for one that is stated per reading."""
    if not follows_scale(name):
        return 1.0
    return 1.0 / scale if "." in name and effect_parameter(name).unit.startswith("1/") else scale


def physical_bounds(name: str, scale: float = 1.0) -> tuple[float, float]:
    """(lowest, highest) that a parameter can be at all; scale: the reading's units in one kg m/s.

    Raises ValueError for unknown names.
    """
    if "." in name:
        known = effect_parameter(name)
        low, high = known.lower, known.upper
    else:
        low, high = _grain(name).limits
    factor = stretch(name, scale)
    return low * factor, high * factor


def search_bounds(name: str, scale: float = 1.0) -> tuple[float, float]:
    """(lowest, highest) in which fits look for a parameter: the physical prior, the same in calibration and diagnosis."""
    if "." in name:
        return physical_bounds(name, scale)
    low, high = _grain(name).search
    factor = stretch(name, scale)
    return low * factor, high * factor


def fitting_bounds(names: Iterable[str], scale: float = 1.0, given: Bounds | None = None) -> dict[str, tuple[float, float]]:
    """Bounds for a calibration: those given, else `search_bounds`."""
    given = given or {}
    return {n: given.get(n) or search_bounds(n, scale) for n in names}


EXCHANGED = "restitution ends at its physical bound: the published exchange coefficients k1, k2 are fitted in its place"
"""Sentence of calibration and diagnosis where 1 + e cannot fit."""


def at_bound_sentence(name: str, side: str, value: float) -> str:
    """Sentence of calibration and diagnosis on a parameter whose best value lies on a bound; side: "lower" or "upper"."""
    return f"{name} is at its {side} bound {value:.6g}: the best fit lies beyond it, so this value is not an estimate."


def _grain(name: str) -> GrainParameter:
    try:
        return GRAIN[name]
    except KeyError:
        raise ValueError(f"parameter {name!r}: unknown; expected one of {', '.join(GRAIN)} or effect.parameter") from None


def start_ranges(names: Iterable[str], scale: float = 1.0) -> dict[str, tuple[float, float]]:
    """Where random starts are drawn: wide for the grain, between nothing and twice the typical size for effects."""
    out: dict[str, tuple[float, float]] = {}
    for name in names:
        if "." in name:
            known = effect_parameter(name)
            far = known.null + 2.0 * (known.typical - known.null)
            low, high = sorted((known.null, min(max(far, known.lower), known.upper)))
        else:
            low, high = _grain(name).start
        factor = stretch(name, scale)
        out[name] = (low * factor, high * factor)
    return out


@dataclass(frozen=True)
class Prior:
    """A Gaussian on some parameters: mean (n,), covariance (n, n), positive definite.

    Raises ValueError when the covariance is not that.
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array

    def __post_init__(self) -> None:
        if self.mean.shape != (len(self.names),) or self.covariance.shape != (len(self.names),) * 2:
            raise ValueError(f"prior for {self.names}: mean {self.mean.shape} and covariance {self.covariance.shape} do not fit")
        try:
            _factor(self.covariance)
        except np.linalg.LinAlgError:
            raise ValueError(f"prior for {self.names}: covariance is not positive definite") from None

    @classmethod
    def of(cls, parameters: ParameterSet, names: Sequence[str] | None = None) -> Prior:
        """The set's own values and covariance, for `names` (default: all that have a variance above 0)."""
        known = tuple(n for n in parameters.covariance_names if parameters.standard_deviation(n) > 0.0)
        chosen = known if names is None else tuple(n for n in names if n in known)
        return cls(chosen, np.array([parameters.values[n] for n in chosen]), parameters.covariance_of(chosen))

    @classmethod
    def independent(cls, mean: Mapping[str, float], standard_deviation: Mapping[str, float]) -> Prior:
        """Uncorrelated parameters."""
        names = tuple(standard_deviation)
        return cls(names, np.array([mean[n] for n in names]), np.diag([standard_deviation[n] ** 2 for n in names]))

    @property
    def standard_deviation(self) -> Array:
        """(n,)"""
        return np.sqrt(np.diag(self.covariance))

    def whitening(self, names: Sequence[str]) -> tuple[Array, Array]:
        """(W, mean) such that |W (theta - mean)|^2 is the prior's -2 log density, theta in the order of `names`.

        W: (n, len(names)); names without a prior have zero columns and mean 0. Raises ValueError where `names` lacks one
        of the prior's.
        """
        # The inverse of the lower Cholesky factor whitens; scaling first keeps densities beside frictions well conditioned.
        white = np.linalg.inv(_factor(self.covariance))
        out, mean = np.zeros((len(self.names), len(names))), np.zeros(len(names))
        for j, name in enumerate(names):
            if name in self.names:
                i = self.names.index(name)
                out[:, j], mean[j] = white[:, i], self.mean[i]
        missing = [n for n in self.names if n not in names]
        if missing:
            raise ValueError(f"prior names {missing} that are not fitted; restrict it first")
        return out, mean

    def restricted(self, names: Sequence[str]) -> Prior:
        """The marginal over those of `names` that it contains."""
        index = [self.names.index(n) for n in names if n in self.names]
        return Prior(tuple(self.names[i] for i in index), self.mean[index], self.covariance[np.ix_(index, index)])


def _factor(covariance: Array) -> Array:
    sd = np.sqrt(np.diag(covariance))
    if not np.all(np.isfinite(sd)) or np.any(sd <= 0.0):
        raise np.linalg.LinAlgError
    return sd[:, None] * np.linalg.cholesky(covariance / np.outer(sd, sd))
