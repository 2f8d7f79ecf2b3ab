"""Updates of a drifting state repeated without those by sweeps, to correct the time before by weighed masses alone.

A sweep is read through the model's profile over the plate angle. Its scatter, and a model error that comes back with each sweep,
go into friction and with it into the flow at home; the drift of friction that the estimator expects lets them. While the machine
harvests that is worth it, since nothing else speaks. Once a weighed mass has spoken, masses measured again by the weighed masses
alone have neither. What an update said apart from what was known before it follows from the state and covariance before and after
it, so that nothing is measured anew.

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
"""Share of a variance by which an update may miss its prior."""


@dataclass(frozen=True, slots=True)
class DriftUpdate:
    """An update and the time before it.

    Parameters
    ----------
    advance : Advance
        How the state came to the update.
    state : ndarray (n,)
        What the update made of it.
    covariance : ndarray (n, n)
        Its covariance then.
    widening : float
        Factor on the parameters' covariance before the update (`Outcome.prior_widening`).
    sweep_alone : bool
        Whether it is by a sweep alone, without a weighed mass or a known density.
    rates : int
        Of the n states, the last ones, which a widening leaves as they are.
    names : tuple of str
        Of the other states; empty where they are not known.
    """

    advance: Advance
    state: Array
    covariance: Array
    widening: float = 1.0
    sweep_alone: bool = False
    rates: int = 0
    names: tuple[str, ...] = ()

    def widened(self, covariance: Array) -> Array:
        """A covariance before the update, (n, n), as the update took it."""
        return widened(covariance, self.names or ("",) * (len(covariance) - self.rates), self.widening)


@dataclass(frozen=True, slots=True)
class _Readings:
    """Independent readings of rows @ state, with their variances: the information of an update, independent of its prior."""

    rows: Array
    values: Array
    variances: Array


def by_weighed_masses(updates: Sequence[DriftUpdate]) -> list[DriftUpdate]:
    """The same updates at the same times, as they would be without the sweeps.

    Parameters
    ----------
    updates : sequence of DriftUpdate
        In order, each beginning where the one before it ended.

    Returns
    -------
    list of DriftUpdate
        Up to the first update of a sweep as given. An update that replaced what was known, where others update it, replaces it
        here too.

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
    """`last` with the state and covariance that an update led to."""
    names = last.parameters.covariance_names
    count = len(names)
    values = {**last.parameters.values, **{n: float(v) for n, v in zip(names, update.state[:count], strict=True)}}
    parameters = replace(last.parameters, values=values, covariance=update.covariance[:count, :count])
    return DriftingParameters(parameters, last.names, update.state[count:], update.covariance)


def _continued(advance: Advance, before: Array, covariance_before: Array) -> Advance:
    """The same time from another state: linear about the one on record, with the same random walk."""
    move = advance.transition
    walk = advance.covariance_after - move @ advance.covariance_before @ move.T
    after = advance.after + move @ (before - advance.before)
    covariance = move @ covariance_before @ move.T + walk
    return Advance(before, covariance_before, move, after, 0.5 * (covariance + covariance.T))


def _readings(update: DriftUpdate) -> _Readings | None:
    """None where the update left something less certain than it was, which no reading does."""
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
    # A reading z of a unit prior variance moves by (1 - left) (z - prior).
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
