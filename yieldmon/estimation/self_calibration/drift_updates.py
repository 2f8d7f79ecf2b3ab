"""Repetition of past updates without the sweeps, to correct past masses by weighed masses alone.

A sweep is evaluated with the model's force over the plate angle. Its scatter, and a model error that recurs with each sweep,
change friction and with it the flow at home, since the estimator expects friction to drift. During harvest sweeps are used
nevertheless, since nothing else measures the drift. Once there is a weighed mass, past masses are recomputed without these errors
from the weighed masses alone. The information of an update is recovered from the state and covariance before and after it, so
that the measurements are not needed again.

Sources: Rauch, Tung and Striebel, AIAA Journal 3 (1965), on the smoother that this serves; Brynjarsdottir and O'Hagan, Inverse
Problems 30 (2014), on what is estimated through a model with an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.physics.numerics import Array

from .drift_spread import SINGULAR
from .steady_drift import Advance, DriftingParameters, widened

_ROUNDING = 1e-6
"""Relative rounding error of a variance in an update."""


@dataclass(frozen=True, slots=True)
class DriftUpdate:
    """An update and the time before it.

    Parameters
    ----------
    advance : Advance
        The time step that ends at the update.
    state : ndarray (n,)
        State after the update: parameters, then rates.
    covariance : ndarray (n, n)
        Its covariance.
    widening : float
        Factor on the parameters' covariance before the update (`Outcome.prior_widening`).
    sweep_alone : bool
        Whether the update used a sweep without a weighed mass or a known density.
    rates : int
        Number of rates, to which the widening does not apply.
    names : tuple of str
        Names of the parameters; empty if they are not known.
    """

    advance: Advance
    state: Array
    covariance: Array
    widening: float = 1.0
    sweep_alone: bool = False
    rates: int = 0
    names: tuple[str, ...] = ()

    def widened(self, covariance: Array) -> Array:
        """A covariance before the update, (n, n), with the update's widening."""
        return widened(covariance, self.names or ("",) * (len(covariance) - self.rates), self.widening)


@dataclass(frozen=True, slots=True)
class _Readings:
    """Independent measurements of rows @ state with variances, equivalent to the data of an update without its prior."""

    rows: Array
    values: Array
    variances: Array


def by_weighed_masses(updates: Sequence[DriftUpdate]) -> list[DriftUpdate]:
    """The updates as they would have been without the sweeps.

    Parameters
    ----------
    updates : sequence of DriftUpdate
        In order of time, without gaps.

    Returns
    -------
    list of DriftUpdate
        Those before the first sweep are unchanged. An update that replaced the former state instead of adding information to it
        replaces it here too.

    Examples
    --------
    Smoothed parameters without the sweeps: ``smoothed([l.advance for l in by_weighed_masses(updates)], last)``, with
    `ending` for `last`.
    """
    found: list[DriftUpdate] = []
    apart = False
    for update in updates:
        if not apart and not update.sweep_alone:
            found.append(update)
            continue
        if not found and not apart:
            before, covariance_before = update.advance.before, update.advance.covariance_before
        else:
            before, covariance_before = found[-1].state, found[-1].covariance
        apart = True
        advance = _continued(update.advance, before, covariance_before)
        state, covariance = advance.after, advance.covariance_after
        if not update.sweep_alone:
            covariance = update.widened(covariance)
            readings = _readings(update)
            if readings is None:
                state, covariance = update.state, update.covariance
            else:
                state, covariance = _read(state, covariance, readings)
        found.append(replace(update, advance=advance, state=state, covariance=covariance))
    return found


def ending(last: DriftingParameters, update: DriftUpdate) -> DriftingParameters:
    """`last` with the state and covariance after an update."""
    names = last.parameters.covariance_names
    count = len(names)
    values = {**last.parameters.values, **{n: float(v) for n, v in zip(names, update.state[:count], strict=True)}}
    parameters = replace(last.parameters, values=values, covariance=update.covariance[:count, :count])
    return DriftingParameters(parameters, last.names, update.state[count:], update.covariance)


def _continued(advance: Advance, before: Array, covariance_before: Array) -> Advance:
    """The same time step from another state, linearised about the recorded one, with the same random walk."""
    move = advance.transition
    walk = advance.covariance_after - move @ advance.covariance_before @ move.T
    after = advance.after + move @ (before - advance.before)
    covariance = move @ covariance_before @ move.T + walk
    return Advance(before, covariance_before, move, after, 0.5 * (covariance + covariance.T))


def _readings(update: DriftUpdate) -> _Readings | None:
    """Measurements equivalent to an update; None if it made a state less certain, which no measurement does."""
    prior = update.widened(update.advance.covariance_after)
    scale = np.sqrt(np.maximum(np.diag(prior), 1e-300))
    sizes, axes = np.linalg.eigh(prior / np.outer(scale, scale))
    used = sizes > SINGULAR * sizes[-1]
    white = (axes[:, used] / np.sqrt(sizes[used])).T / scale
    left, turned = np.linalg.eigh(white @ update.covariance @ white.T)
    if left[-1] > 1.0 + _ROUNDING:
        return None
    informed = left < 1.0 - _ROUNDING
    left = np.maximum(left[informed], SINGULAR)
    rows = turned[:, informed].T @ white
    # With unit prior variance, a reading z changes the state by (1 - left) (z - prior).
    values = rows @ update.advance.after + rows @ (update.state - update.advance.after) / (1.0 - left)
    return _Readings(rows, values, left / (1.0 - left))


def _read(state: Array, covariance: Array, readings: _Readings) -> tuple[Array, Array]:
    for row, value, variance in zip(readings.rows, readings.values, readings.variances, strict=True):
        tie = covariance @ row
        gain = tie / (row @ tie + variance)
        state = state + gain * (value - row @ state)
        left = np.eye(state.size) - np.outer(gain, row)
        covariance = left @ covariance @ left.T + variance * np.outer(gain, gain)
    return state, 0.5 * (covariance + covariance.T)
