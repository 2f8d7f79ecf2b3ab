"""Parameters over time, as the weighed masses together have them, from the steps between their updates.

The updates' steps, kept in the store, are taken without those of sweeps (`estimation.self_calibration.drift_updates`) and
smoothed (`estimation.self_calibration.steady_drift.smoothed`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.engine.self_calibration.calibrator import CalibrationStep
from yieldmon.engine.self_calibration.curve_states import in_names
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.drift_spread import MEAN_SQUARE
from yieldmon.estimation.self_calibration.drift_updates import DriftUpdate, by_weighed_masses, ending
from yieldmon.estimation.self_calibration.steady_drift import Advance, DriftingParameters, smoothed, smoothed_covariances, updated
from yieldmon.physics.numerics import Array
from yieldmon.service.history.update_steps import step_from_document
from yieldmon.service.storage.batch import Step

_CONTRADICTION = 10.83
"""Squared standard deviations by which an update moves the parameters; chance exceeds it once in a thousand updates."""


@dataclass(frozen=True)
class Interval:
    """Bus time between two moments at which the parameters are known; added: covariance (n, n) that drift adds over it."""

    begin_s: float
    end_s: float
    added: Array

    def covariance_at(self, time_s: float) -> Array:
        """Covariance (n, n) of a Brownian bridge between the two ends; 0 outside."""
        if not self.begin_s < time_s < self.end_s:
            return np.zeros_like(self.added)
        share = (time_s - self.begin_s) / (self.end_s - self.begin_s)
        return np.asarray(share * (1.0 - share) * self.added)


@dataclass(frozen=True)
class Timeline:
    """Parameters over time.

    Parameters
    ----------
    parameters : ParameterSet
        Those in use, at the end.
    names : tuple of str
        (n,) parameters that change.
    times_s : ndarray
        (k,) bus time, rising.
    values : ndarray
        (k, n) of `names`.
    versions : frozenset of int
        Versions of the parameters that were in use over it.
    holds_from_s : float
        Bus time at which the newest update that contradicts the drift began; what follows says nothing of the days before.
    covariances : ndarray or None
        (k, n, n) of the values.
    intervals : tuple of Interval
        Between neighbouring times, and between weighed masses, with what drift may have added there.
    """

    parameters: ParameterSet
    names: tuple[str, ...]
    times_s: Array
    values: Array
    versions: frozenset[int]
    holds_from_s: float = -np.inf
    covariances: Array | None = None
    intervals: tuple[Interval, ...] = ()

    def at(self, time_s: float) -> ParameterSet:
        """The parameters at a time, as the weighed masses together have them."""
        here = {name: float(np.interp(time_s, self.times_s, self.values[:, i])) for i, name in enumerate(self.names)}
        return replace(self.parameters, values={**self.parameters.values, **here})

    def covariance_at(self, time_s: float) -> Array:
        """Their covariance (n, n) at a time: between two known times, interpolated, and that of the drift in between."""
        if self.covariances is None:
            return self.parameters.covariance
        entries = np.array(
            [np.interp(time_s, self.times_s, column) for column in self.covariances.reshape(len(self.times_s), -1).T]
        )
        drift = (interval.covariance_at(time_s) for interval in self.intervals)
        return np.asarray(sum(drift, entries.reshape(self.covariances.shape[1:])))


def timeline(steps: Sequence[Step], parameters: ParameterSet, sets: Mapping[int, ParameterSet] | None = None) -> Timeline:
    """The timeline that ends at these parameters.

    Parameters
    ----------
    steps : sequence of Step
        Of the store; used are those that led to `parameters` without a gap.
    parameters : ParameterSet
        Those of the last step's version.
    sets : mapping of int to ParameterSet, optional
        Parameters by version. Versions with equal parameters count as one: a change of crop stores parameters under a further
        version.

    Returns
    -------
    Timeline
        Of one point where no step led to the parameters.
    """
    chain: list[CalibrationStep] = []
    by_version = {step.version: step for step in steps}
    equal = _equal_versions(parameters.version, sets or {})
    versions = set(equal)
    while True:
        version = max(equal & by_version.keys(), default=None)
        if version is None:
            break
        # Each once: versions of a store that was tampered with may lead to themselves.
        found = step_from_document(by_version.pop(version).document)
        if found is not None and found.names:
            found = in_names(found, parameters.covariance_names)
        if found is None or len(found.state) < len(parameters.covariance_names):
            break
        if chain and len(found.state) != len(chain[-1].state):
            break
        chain.append(found)
        equal = _equal_versions(found.from_version, sets or {})
        versions |= equal
    names = parameters.covariance_names
    if not chain:
        return Timeline(parameters, (), np.zeros(1), np.zeros((1, 0)), frozenset(versions))
    chain.reverse()
    state = np.array(chain[-1].state)
    rates = tuple(names[: len(state) - len(names)])  # Only their number counts here.
    updates = by_weighed_masses(_updates(chain, parameters, rates))
    last = DriftingParameters(parameters, rates, state[len(names) :], np.zeros((state.size,) * 2))
    advances, end = [update.advance for update in updates], ending(last, updates[-1])
    known = smoothed(advances, end)
    covariances = np.array(smoothed_covariances(advances, end))
    times = np.array([*(step.begin_s for step in chain), chain[-1].end_s])
    values = np.array([[point[name] for name in names] for point in known])
    broken = [step.begin_s for step, update in zip(chain, updates, strict=True) if _contradicts(update.advance, update.state)]
    return Timeline(
        parameters,
        names,
        np.maximum.accumulate(times),
        values,
        frozenset(versions),
        max(broken, default=-np.inf),
        covariances,
        _intervals(chain, advances, len(names)),
    )


def _intervals(chain: Sequence[CalibrationStep], advances: Sequence[Advance], count: int) -> tuple[Interval, ...]:
    """What drift adds over each step, and what rates may add from one weighed mass to the next, as nothing has shown that they
    are steady in between. count: number of parameters."""
    found, begin_s, rates, move = (
        list[Interval](),
        chain[0].begin_s,
        _rates_of(advances[0], count),
        np.eye(len(advances[0].before)),
    )
    for step, advance in zip(chain, advances, strict=True):
        added = advance.covariance_after - advance.transition @ advance.covariance_before @ advance.transition.T
        found.append(Interval(step.begin_s, step.end_s, added[:count, :count]))
        move = advance.transition @ move
        if step.sweep_alone:
            continue
        by_rates = move[:count, count:] @ rates @ move[:count, count:].T
        found.append(Interval(begin_s, step.end_s, MEAN_SQUARE * by_rates))
        begin_s, move = step.end_s, np.eye(len(move))
        rates = _rates_of(advance, count)
    return tuple(found)


def _rates_of(advance: Advance, count: int) -> Array:
    return advance.covariance_before[count:, count:]


def _equal_versions(version: int, sets: Mapping[int, ParameterSet]) -> set[int]:
    """The versions whose parameters and crop equal those of this one, and itself."""
    known = sets.get(version)
    return {version} if known is None else {version, *(other for other, found in sets.items() if _are_equal(found, known))}


def _are_equal(found: ParameterSet, known: ParameterSet) -> bool:
    crops = {parameters.provenance["crop"] for parameters in (found, known) if "crop" in parameters.provenance}
    same = found.values == known.values and found.covariance_names == known.covariance_names and len(crops) < 2
    return same and np.array_equal(found.covariance, known.covariance)


def _updates(chain: Sequence[CalibrationStep], parameters: ParameterSet, rates: tuple[str, ...]) -> list[DriftUpdate]:
    """What each update made of the state: where the next step begins, and after the last the parameters in use."""
    end, names = chain[-1], parameters.covariance_names
    after = end.advance.after
    values = dict(zip(names, map(float, after), strict=False))
    covariance = end.advance.covariance_after
    prior = replace(parameters, values={**parameters.values, **values}, covariance=covariance[: len(names), : len(names)])
    known = DriftingParameters(prior, rates, after[len(names) :], covariance)
    states = [*(step.advance.before for step in chain[1:]), np.array(end.state)]
    covariances = [
        *(step.advance.covariance_before for step in chain[1:]),
        updated(known, parameters, widening=end.widening).joint,
    ]
    return [
        DriftUpdate(step.advance, state, covariance, step.widening, step.sweep_alone, len(rates), names)
        for step, state, covariance in zip(chain, states, covariances, strict=True)
    ]


def _contradicts(expected: Advance, state: Array) -> bool:
    """Whether an update moved the state further than what was expected before it allows."""
    scale = np.sqrt(np.maximum(np.diag(expected.covariance_after), 1e-300))
    moved = (state - expected.after) / scale
    inverse = np.linalg.pinv(expected.covariance_after / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    return bool(moved @ inverse @ moved > _CONTRADICTION)
