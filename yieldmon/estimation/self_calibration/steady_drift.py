"""Parameters that drift at a steady, unknown rate. The rates are estimated too, and later updates correct past values.

Wear and a ripening crop change friction, impact gain and density in one direction for weeks. A random walk alone (`drift.grow`)
does not represent that successive steps have the same sign. With the rates as further states, hundreds of sweeps and a few
weighed loads determine the drift. The state is (parameters, rates). Rates are not measured directly but are updated through their
covariance with the parameters. A rate decays to 0 over some harvested mass, and its standard deviation returns to the expected
size (an Ornstein-Uhlenbeck process), so that another field, crop or year can have another rate.

Sources: Harvey, "Forecasting, structural time series models and the Kalman filter" (1989), local linear trend; Gardner and
McKenzie, "Forecasting trends in time series" (1985), the damped trend; Rauch, Tung and Striebel, "Maximum likelihood estimates of
linear dynamic systems" (1965), for the smoother.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import expm1, inf, isinf

import numpy as np

from yieldmon.estimation.fitting.identifiability import natural_scale
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.effects.other_monitor import BIAS
from yieldmon.physics.grain import drift_key
from yieldmon.physics.numerics import Array

from .drift import grow
from .drift_rates import KG_PER_KT, DriftRates

_SHORT = 1e-2
"""Grain relative to a rate's memory below which a variance is computed from its series."""


@dataclass(frozen=True)
class DriftingParameters:
    """State of n parameters and the drift rates of r of them.

    Attributes
    ----------
    parameters : ParameterSet
    names : tuple of str
        Parameters that have a rate.
    rates : ndarray (r,)
        Change per kilotonne of grain relative to the parameter's natural scale (itself; 1 + restitution for restitution).
    joint : ndarray (n + r, n + r)
        Covariance of `parameters.covariance_names`, then the rates.

    Raises
    ------
    ValueError
        If the shapes do not fit, or a name has no variance.
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
    """One time step: state and covariance before and after it, and the transition matrix."""

    before: Array
    covariance_before: Array
    transition: Array
    after: Array
    covariance_after: Array


def begin(parameters: ParameterSet, per_kilotonne: Mapping[str, float]) -> DriftingParameters:
    """The initial state, with rates of 0.

    Parameters
    ----------
    parameters : ParameterSet
        Those without a variance count as exactly known and get no rate.
    per_kilotonne : mapping of str to float
        Standard deviations of the rates; that of restitution also for k1 and k2.

    Raises
    ------
    ValueError
        For a negative standard deviation.
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
    known: DriftingParameters,
    random: DriftRates,
    hours: float,
    harvested_kg: float,
    *,
    per_kilotonne: Mapping[str, float] | None = None,
    memory_kt: float = inf,
) -> tuple[DriftingParameters, Advance]:
    """The state after some time and harvested mass: rates change the parameters, and the random walk adds variance.

    Parameters
    ----------
    known : DriftingParameters
    random : DriftRates
        Random walk of the parameters.
    hours, harvested_kg : float
        Time and harvested mass of the step, 0 or more.
    per_kilotonne : mapping of str to float, optional
        Expected sizes of the rates, as in `begin`. A rate's standard deviation returns to them as it decays.
    memory_kt : float
        Harvested mass over which a rate decays to 1/e, kt; inf: it does not decay.

    Returns
    -------
    DriftingParameters, Advance

    Raises
    ------
    ValueError
        For a negative amount, or a memory that is not above 0.
    """
    if not memory_kt > 0.0:
        raise ValueError(f"a rate's memory is {memory_kt} kt; expected more than 0")
    left, lasting, *_ = _forgetting(harvested_kg / KG_PER_KT, memory_kt)
    parameters, count = known.parameters, len(known.parameters.covariance_names)
    transition = np.eye(len(known.joint))
    added = forgotten(known, harvested_kg, per_kilotonne=per_kilotonne, memory_kt=memory_kt)
    values, rates = dict(parameters.values), known.rates * left
    for i, name in enumerate(known.names):
        row, size = parameters.covariance_names.index(name), natural_scale(name, values[name])
        transition[row, count + i] = size * lasting
        transition[row, row] += known.rates[i] * lasting
        transition[count + i, count + i] = left
        values[name] += size * known.rates[i] * lasting
    joint = transition @ known.joint @ transition.T + added
    joint = 0.5 * (joint + joint.T)
    moved = replace(parameters, values=values, covariance=joint[:count, :count])
    grown = grow(moved, random, hours, harvested_kg)
    joint[:count, :count] = grown.covariance
    later = DriftingParameters(grown, known.names, rates, joint)
    return later, Advance(known.state, known.joint, transition, later.state, joint)


def forgotten(
    known: DriftingParameters, harvested_kg: float, *, per_kilotonne: Mapping[str, float] | None = None, memory_kt: float = inf
) -> Array:
    """Covariance (n + r, n + r) added over some grain by the decay of rates; arguments as in `advance`."""
    parameters, count = known.parameters, len(known.parameters.covariance_names)
    _, _, variance, tie, own = _forgetting(harvested_kg / KG_PER_KT, memory_kt)
    added = np.zeros_like(known.joint)
    for i, name in enumerate(known.names):
        row = parameters.covariance_names.index(name)
        size, likely = natural_scale(name, parameters.values[name]), (per_kilotonne or {}).get(drift_key(name), 0.0)
        added[row, row] = variance * (size * likely) ** 2
        added[row, count + i] = added[count + i, row] = tie * size * likely**2
        added[count + i, count + i] = own * likely**2
    return added


def with_gain_error(
    known: DriftingParameters, step: Advance, relative: float, *, all_along: bool = False
) -> tuple[DriftingParameters, Advance]:
    """Add an uncertainty of the impact gain, for example because the parameters do not depend on the grain's moisture.

    Parameters
    ----------
    known : DriftingParameters
    step : Advance
        The time step that ends at `known`.
    relative : float
        Additional relative standard deviation of the gain, 0 or more. Without a gain that has a variance nothing changes.
    all_along : bool
        Whether the error existed before the step as well, so that an update of it also corrects the time before.

    Returns
    -------
    DriftingParameters, Advance
    """
    names = [name for name in known.parameters.covariance_names if drift_key(name) == "restitution"]
    if not (relative > 0.0 and names):
        return known, step
    direction, then = np.zeros((2, len(known.joint)))
    for name in names:
        place = known.parameters.covariance_names.index(name)
        direction[place] = natural_scale(name, known.parameters.values[name])
        then[place] = natural_scale(name, float(step.before[place]))
    joint = known.joint + relative**2 * np.outer(direction, direction)
    count = len(known.parameters.covariance_names)
    wider = replace(known, parameters=replace(known.parameters, covariance=joint[:count, :count]), joint=joint)
    before = step.covariance_before + (relative**2 * np.outer(then, then) if all_along else 0.0)
    return wider, replace(step, covariance_before=before, covariance_after=joint)


def _forgetting(grain_kt: float, memory_kt: float) -> tuple[float, float, float, float, float]:
    """Decay of a rate over some grain.

    Returns
    -------
    left : float
        Share of the rate that remains.
    lasting : float
        Integral of this share over the grain, kt.
    variance, tie, own : float
        Added variance of the parameter, covariance of parameter and rate, and variance of the rate, for an expected size of 1.
    """
    if isinf(memory_kt) or grain_kt <= 0.0:
        return 1.0, max(grain_kt, 0.0), 0.0, 0.0, 0.0
    share = grain_kt / memory_kt
    gone = -expm1(-share)
    left = 1.0 - gone
    # Doob, "The Brownian movement and stochastic equations" (1942): integral of the process and its end.
    exact = 2.0 * share - 2.0 * gone - gone**2
    moved = exact if share > _SHORT else share**3 * (2.0 / 3.0 - 0.5 * share + 7.0 / 30.0 * share**2)
    return left, memory_kt * gone, memory_kt**2 * moved, memory_kt * gone**2, gone * (1.0 + left)


def widened(joint: Array, names: Sequence[str], widening: float) -> Array:
    """A joint covariance with the variances of its first states, the parameters of these names, multiplied by a factor.

    Covariances with rates stay the same, since a sudden change is no lasting drift. So does the variance of another combine's
    monitor, which has not changed.
    """
    found, count = joint.copy(), len(names)
    factor = np.array([1.0 if name == BIAS else widening**0.5 for name in names])
    found[:count, :count] *= np.outer(factor, factor)
    return found


def carried(known: DriftingParameters, parameters: ParameterSet) -> DriftingParameters:
    """The same rates with parameters that were changed by something other than time, such as moisture. Errors are scaled with the
    values.

    Raises ValueError if the covariances have different names.
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


def updated(known: DriftingParameters, posterior: ParameterSet, *, widening: float = 1.0) -> DriftingParameters:
    """The state after an update of its parameters. The rates change by their covariance with the parameters.

    Parameters
    ----------
    known : DriftingParameters
        State before; its parameters were the update's prior.
    posterior : ParameterSet
        Parameters after the update.
    widening : float
        Factor on the parameters' prior covariance in the update (`Outcome.prior_widening`).

    Raises
    ------
    ValueError
        If the posterior has other parameters.
    """
    names = known.parameters.covariance_names
    if posterior.covariance_names != names:
        raise ValueError(f"posterior of {list(posterior.covariance_names)}; expected {list(names)}")
    count = len(names)
    joint = widened(known.joint, names, widening)
    prior = joint[:count, :count]
    scale = np.sqrt(np.diag(prior))
    gain = np.linalg.lstsq(prior / np.outer(scale, scale), joint[:count] / scale[:, None], rcond=1e-12)[0].T / scale
    step = np.array([posterior.values[n] - known.parameters.values[n] for n in names])
    joint = joint - gain @ (prior - posterior.covariance) @ gain.T
    joint[:count, :count] = posterior.covariance
    joint = 0.5 * (joint + joint.T)
    return DriftingParameters(posterior, known.names, known.rates + (gain @ step)[count:], joint)


def smoothed(steps: Sequence[Advance], last: DriftingParameters) -> list[Mapping[str, float]]:
    """Parameter values at the beginning of each step, given all updates up to `last`; the last entry is `last`'s own values.

    Fixed-interval smoother. steps: all of one run, in order. Between two steps the state changes by an update.
    """
    names = last.parameters.covariance_names
    state = last.state
    found: list[Mapping[str, float]] = [dict(last.parameters.values)]
    for step in reversed(steps):
        state = step.before + _smoother_gain(step) @ (state - step.after)
        found.append(dict(last.parameters.values) | {n: float(v) for n, v in zip(names, state, strict=False)})
    return found[::-1]


def smoothed_covariances(steps: Sequence[Advance], last: DriftingParameters) -> list[Array]:
    """Covariances (n, n) of the parameter values that `smoothed` returns."""
    count, joint = len(last.parameters.covariance_names), last.joint
    found = [joint[:count, :count]]
    for step in reversed(steps):
        gain = _smoother_gain(step)
        joint = step.covariance_before + gain @ (joint - step.covariance_after) @ gain.T
        found.append(joint[:count, :count])
    return found[::-1]


def _smoother_gain(step: Advance) -> Array:
    scale = np.sqrt(np.maximum(np.diag(step.covariance_after), 1e-300))
    after = step.covariance_after / np.outer(scale, scale)
    gain = (step.covariance_before @ step.transition.T / scale) @ np.linalg.pinv(after, rcond=1e-12, hermitian=True) / scale
    return np.asarray(gain)
