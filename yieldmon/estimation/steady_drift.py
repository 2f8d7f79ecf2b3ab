"""Parameters that drift at a steady, unknown rate: the rates are learnt along with them, and later updates correct the past.

Wear and a ripening crop move friction, impact gain and density in one direction for weeks. A random walk alone (`drift.grow`)
forgets at every step what the steps before had in common; with rates as further states, hundreds of sweeps and a few weighed
loads add up. States are (parameters, rates); the rates are never measured, they follow by their covariance with the parameters.

Sources: Harvey, "Forecasting, structural time series models and the Kalman filter" (1989), local linear trend; Rauch, Tung and
Striebel, "Maximum likelihood estimates of linear dynamic systems" (1965), for the smoother.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.physics.grain import drift_key
from yieldmon.physics.numerics import Array

from .drift import grow
from .drift_rates import DriftRates
from .identifiability import natural_scale
from .parameters import ParameterSet

_KILOTONNE_KG = 1e6


@dataclass(frozen=True)
class DriftingParameters:
    """What is known of n parameters and of the rates of r among them.

    names: the r, in the order of rates. rates: (r,) change per kilotonne of grain in the parameter's natural scale (itself; 1 +
    restitution for restitution). joint: (n + r, n + r) covariance of `parameters.covariance_names`, then the rates.
    Raises ValueError when the shapes do not fit or a name has no variance.
    """

    parameters: ParameterSet
    names: tuple[str, ...]
    rates: Array
    joint: Array

    def __post_init__(self) -> None:
        size = len(self.parameters.covariance_names) + len(self.names)
        if self.rates.shape != (len(self.names),) or self.joint.shape != (size, size):
            raise ValueError(f"rates {self.rates.shape} and covariance {self.joint.shape} do not fit {size} states")
        unknown = [name for name in self.names if name not in self.parameters.covariance_names]
        if unknown:
            raise ValueError(f"rates of {unknown}; expected some of {list(self.parameters.covariance_names)}")

    @property
    def state(self) -> Array:
        """(n + r,): parameters, then rates."""
        known = self.parameters
        return np.concatenate(([known.values[name] for name in known.covariance_names], self.rates))


@dataclass(frozen=True, slots=True)
class Advance:
    """One step of time: states and covariances before and after it, and the matrix between."""

    before: Array
    covariance_before: Array
    transition: Array
    after: Array
    covariance_after: Array


def begin(parameters: ParameterSet, per_kilotonne: Mapping[str, float]) -> DriftingParameters:
    """Rates of 0 with the given standard deviations (restitution's for k1 and k2 too); parameters without variance have none,
    and count as exactly known.

    Raises ValueError for a negative standard deviation.
    """
    for name, rate in per_kilotonne.items():
        if not rate >= 0.0:
            raise ValueError(f"drift rate of {name} is {rate}; expected 0 or more")
    unsure = tuple(n for n in parameters.covariance_names if parameters.standard_deviation(n) > 0.0)
    if unsure != parameters.covariance_names:
        parameters = replace(parameters, covariance_names=unsure, covariance=parameters.covariance_of(unsure))
    names = tuple(n for n in unsure if per_kilotonne.get(drift_key(n), 0.0) > 0.0)
    count = len(parameters.covariance_names)
    joint = np.zeros((count + len(names),) * 2)
    joint[:count, :count] = parameters.covariance
    for i, name in enumerate(names):
        joint[count + i, count + i] = per_kilotonne[drift_key(name)] ** 2
    return DriftingParameters(parameters, names, np.zeros(len(names)), joint)


def advance(
    known: DriftingParameters, random: DriftRates, hours: float, harvested_kg: float
) -> tuple[DriftingParameters, Advance]:
    """What is known `hours` and `harvested_kg` later: the rates move the parameters, the random walk widens them.

    Raises ValueError for negative amounts.
    """
    grain = harvested_kg / _KILOTONNE_KG
    parameters, count = known.parameters, len(known.parameters.covariance_names)
    transition = np.eye(len(known.joint))
    values = dict(parameters.values)
    for i, name in enumerate(known.names):
        row = parameters.covariance_names.index(name)
        size = natural_scale(name, values[name])
        transition[row, count + i] = size * grain
        transition[row, row] += known.rates[i] * grain
        values[name] += size * known.rates[i] * grain
    joint = transition @ known.joint @ transition.T
    joint = 0.5 * (joint + joint.T)
    moved = replace(parameters, values=values, covariance=joint[:count, :count])
    grown = grow(moved, random, hours, harvested_kg)
    joint[:count, :count] = grown.covariance
    later = DriftingParameters(grown, known.names, known.rates, joint)
    return later, Advance(known.state, known.joint, transition, later.state, joint)


def carried(known: DriftingParameters, parameters: ParameterSet) -> DriftingParameters:
    """The same rates where the parameters have been moved by something other than time (moisture): errors go along with values.

    Raises ValueError when the covariances are not of the same names.
    """
    if parameters is known.parameters:
        return known
    names = known.parameters.covariance_names
    if parameters.covariance_names != names:
        raise ValueError(f"moved parameters have variances of {list(parameters.covariance_names)}; expected {list(names)}")
    before, after = known.parameters.values, parameters.values
    scale = np.array([after[n] / before[n] if before[n] != 0.0 else 1.0 for n in names] + [1.0] * len(known.names))
    joint = known.joint * np.outer(scale, scale)
    joint[: len(names), : len(names)] = parameters.covariance
    return DriftingParameters(parameters, known.names, known.rates, joint)


def learn(known: DriftingParameters, posterior: ParameterSet, *, widening: float = 1.0) -> DriftingParameters:
    """After an update whose prior was `known.parameters`: the rates follow by their covariance with the parameters.

    widening: what the update multiplied the prior's covariance by (`Outcome.prior_widening`). Raises ValueError when
    the posterior is of other parameters.
    """
    names = known.parameters.covariance_names
    if posterior.covariance_names != names:
        raise ValueError(f"posterior of {list(posterior.covariance_names)}; expected {list(names)}")
    count = len(names)
    joint = known.joint * widening
    prior = joint[:count, :count]
    scale = np.sqrt(np.diag(prior))
    gain = np.linalg.lstsq(prior / np.outer(scale, scale), joint[:count] / scale[:, None], rcond=1e-12)[0].T / scale
    step = np.array([posterior.values[n] - known.parameters.values[n] for n in names])
    joint = joint - gain @ (prior - posterior.covariance) @ gain.T
    joint[:count, :count] = posterior.covariance
    joint = 0.5 * (joint + joint.T)
    return DriftingParameters(posterior, known.names, known.rates + (gain @ step)[count:], joint)


def smoothed(steps: Sequence[Advance], last: DriftingParameters) -> list[Mapping[str, float]]:
    """Parameter values at the beginning of each step, as all updates up to `last` have them; and `last`'s own at the end.

    steps: all of one run, in order. Fixed-interval smoother; an update between two steps is what changed the state between them.
    """
    names = last.parameters.covariance_names
    state = last.state
    found: list[Mapping[str, float]] = [dict(last.parameters.values)]
    for step in reversed(steps):
        scale = np.sqrt(np.maximum(np.diag(step.covariance_after), 1e-300))
        after = step.covariance_after / np.outer(scale, scale)
        gain = (step.covariance_before @ step.transition.T / scale) @ np.linalg.pinv(after, rcond=1e-12, hermitian=True) / scale
        state = step.before + gain @ (state - step.after)
        found.append(dict(last.parameters.values) | {n: float(v) for n, v in zip(names, state, strict=False)})
    return found[::-1]
