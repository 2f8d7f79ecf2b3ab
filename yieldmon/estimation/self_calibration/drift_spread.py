"""Additional uncertainty of the parameters, because the expected size of steady drift rates is itself uncertain.

`steady_drift` assumes given sizes of the rates. A weighed mass fixes the scale, but until the next one nothing measures how fast
the scale drifts: sweeps do not observe it, and the bias of kernel noise drifts as well. Therefore the part of the covariance that
comes from the rates, here called the spread, is propagated separately through the same steps and updates with the same gains. The
stated uncertainty contains it, multiplied by the mean square of the possible sizes of the rates. Values and updates stay the
same.

Source: Gelb, "Applied optimal estimation" (1974), chapter 7, on the error covariance of an estimator made for other noise.
"""

from __future__ import annotations

from math import log

import numpy as np

from yieldmon.physics.numerics import Array

SLOWEST, FASTEST = 0.5, 4.5
"""Range of the true size of the rates relative to the assumed one. The extremes are those of two seasons, in which friction
changed by 15 % in 60 h and density by up to 15 % in 480 t."""
MEAN_SQUARE = (FASTEST**2 - SLOWEST**2) / (2.0 * log(FASTEST / SLOWEST))
"""Mean square of a size with a log-uniform distribution in this range."""
SINGULAR = 1e-12
"""Share of the largest eigenvalue of a correlation matrix below which an eigenvalue counts as 0."""


def begin(covariance: Array, rates: int) -> Array:
    """Initial spread of n states, the last `rates` of which are rates, and of the bias of kernel noise, (n + 1, n + 1)."""
    spread = np.zeros((len(covariance) + 1,) * 2)
    first = len(covariance) - rates
    spread[first:-1, first:-1] = covariance[first:, first:]
    return spread


def advanced(spread: Array, transition: Array, forgotten: Array) -> Array:
    """Spread after a time step with the states' transition matrix (n, n) and the covariance (n, n) added by forgetting of
    rates."""
    whole = np.eye(len(spread))
    whole[:-1, :-1] = transition
    later: Array = whole @ spread @ whole.T
    later[:-1, :-1] += forgotten
    return 0.5 * (later + later.T)


def updated(spread: Array, errors: Array) -> Array:
    """Spread after an update that, apart from its own noise, changed errors e of states and bias to errors @ e, (n + 1, n +
    1)."""
    later: Array = errors @ spread @ errors.T
    return 0.5 * (later + later.T)


def by_update(before: Array, after: Array) -> Array:
    """Matrix by which an update changed the errors of all states, after @ inverse(before), (n, n).

    It holds for an update that is optimal for the covariance before.
    """
    scale = np.sqrt(np.maximum(np.diag(before), 1e-300))
    inverse = np.linalg.pinv(before / np.outer(scale, scale), rcond=SINGULAR, hermitian=True)
    return np.asarray((after / scale) @ inverse / scale)


def with_bias(covariance: Array, bias: tuple[Array, float] | None) -> Array:
    """Covariance of n states and the bias. bias: covariance of the bias with the states, (n,), and its variance; None: there is
    none."""
    cross, variance = (np.zeros(len(covariance)), 1.0) if bias is None else bias
    return np.block([[covariance, cross[:, None]], [cross[None], np.array([[variance]])]])


def beyond(spread: Array, parameters: int) -> Array:
    """Additional covariance of the first states, the parameters, (parameters, parameters)."""
    return np.asarray((MEAN_SQUARE - 1.0) * spread[:parameters, :parameters])
