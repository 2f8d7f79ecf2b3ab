"""What steady drift may have added to the parameters' error beyond their covariance, since the size of its rates is not known.

`steady_drift` takes the likely sizes of rates as they are given. A weighed mass fixes the scale, and until the next one nothing
shows how fast it drifts: sweeps do not see it, and kernel noise has a bias that wanders as well. So the part of the covariance
that comes from the rates is carried beside it, through the same steps and updates with the gains that they had, and counts in
what is stated by the mean square of the sizes that the rates may have. Values and updates are not changed.

Source: Gelb, "Applied optimal estimation" (1974), chapter 7, on the error covariance of an estimator made for other noise.
"""

from __future__ import annotations

from math import log

import numpy as np

from yieldmon.physics.numerics import Array

SLOWEST, FASTEST = 0.5, 4.5
"""Over the rates' likely sizes: those of two seasons, friction by 15 % in 60 h and density by up to 15 % in 480 t."""
MEAN_SQUARE = (FASTEST**2 - SLOWEST**2) / (2.0 * log(FASTEST / SLOWEST))
"""Of a size that is as likely in each octave between the two."""
SINGULAR = 1e-12
"""Of the largest eigenvalue of a correlation matrix: smaller ones are none."""


def begin(covariance: Array, rates: int) -> Array:
    """Spread of n states, of which the last ones are rates, and of the bias of kernel noise: (n + 1, n + 1)."""
    spread = np.zeros((len(covariance) + 1,) * 2)
    first = len(covariance) - rates
    spread[first:-1, first:-1] = covariance[first:, first:]
    return spread


def advanced(spread: Array, transition: Array, forgotten: Array) -> Array:
    """After a time: states went by `transition` (n, n), and rates that were forgotten added `forgotten` (n, n)."""
    whole = np.eye(len(spread))
    whole[:-1, :-1] = transition
    later: Array = whole @ spread @ whole.T
    later[:-1, :-1] += forgotten
    return 0.5 * (later + later.T)


def updated(spread: Array, errors: Array) -> Array:
    """After an update that took errors e of states and bias to `errors @ e` (n + 1, n + 1), but for its own noise."""
    later: Array = errors @ spread @ errors.T
    return 0.5 * (later + later.T)


def by_update(before: Array, after: Array) -> Array:
    """What an update did to the errors of all states, (n, n), from their covariance before and after it.

    For an update that weighs by the covariance before: what is left of an error is after / before.
    """
    scale = np.sqrt(np.maximum(np.diag(before), 1e-300))
    inverse = np.linalg.pinv(before / np.outer(scale, scale), rcond=SINGULAR, hermitian=True)
    return np.asarray((after / scale) @ inverse / scale)


def with_bias(covariance: Array, bias: tuple[Array, float] | None) -> Array:
    """Covariance of n states and of the bias: its covariance with them (n,) and its variance; None: it is not known of."""
    cross, variance = (np.zeros(len(covariance)), 1.0) if bias is None else bias
    return np.block([[covariance, cross[:, None]], [cross[None], np.array([[variance]])]])


def beyond(spread: Array, parameters: int) -> Array:
    """What the first so many states are unsure by beyond their covariance, (parameters, parameters)."""
    return np.asarray((MEAN_SQUARE - 1.0) * spread[:parameters, :parameters])
