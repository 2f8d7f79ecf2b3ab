"""Samples minus the mean pulses, with an individual size, time and width of each pulse."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

from .pattern_fold import FoldedPattern

_TINY = 1e-150
_LEAST_DETERMINANT = 1e-6
"""Least determinant of the scaled normal equations with which a pulse's size, time and width are fitted."""
_HALF_MISSING = -0.5
"""Relative change of a pulse's size below which its time is not used."""
_LEAST_OF_A_PULSE = 12
"""Least number of samples for a fit of a pulse; one at an end of the window may have fewer."""


def residuals_of_pulses(
    samples_n: Sequence[Array], phases: Sequence[Array], folded: Sequence[FoldedPattern], spacings_m: Sequence[float]
) -> list[tuple[Array, Array]]:
    """Samples of several windows minus the mean pattern, with a size, time and width fitted to each pulse.

    Loads differ between paddles, a heavier load arrives over a longer time, and the phase drifts by tenths of a millisecond. The
    residuals that these cause at a steep pulse are not noise. Size, time and width are fitted by least squares on the mean, its
    slope, and its slope times the phase from the pulse's middle, between the valleys before and after the pulse.

    Parameters
    ----------
    samples_n, phases : sequence of ndarray (n,)
        Samples and phases of each window in order of time, as in `pattern_fold.fold_all`.
    folded : sequence of FoldedPattern
        Mean pattern of each window, with a sample in every bin; all with the same number of bins.
    spacings_m : sequence of float
        Spacings of the paddles in the pattern.

    Returns
    -------
    list of tuple
        For each window, bit for bit independent of the others: the residuals (n,), N; and the delay (p,) in turns of the pattern
        of each pulse that is complete and has at least half the size of the mean pulse.
    """
    if not samples_n:
        return []
    lengths, means_n = [phase.size for phase in phases], np.array([pattern.mean_n for pattern in folded])
    steps = [float(phase[-1] - phase[0]) / max(phase.size - 1, 1) for phase in phases]
    phase, window = np.concatenate(phases), np.repeat(np.arange(len(phases)), lengths)
    places = np.cumsum(spacings_m)
    edges = places / places[-1]
    paddles = edges.size

    rows = np.empty((4, phase.size))
    mean, slope, wider, left = rows
    rows[:2] = _between(np.array([means_n, _steepness(means_n, steps)]), phase, window)
    np.subtract(np.concatenate(samples_n), mean, out=left)
    from_valley = phase - _valleys(means_n, edges)[window]
    turn = np.floor(from_valley)
    within = from_valley - turn
    paddle = (within >= edges[0]).astype(np.intp) if paddles == 2 else np.searchsorted(edges[:-1], within, side="right")
    height, kind = np.abs(mean), paddles * window + paddle
    kinds = paddles * len(phases)
    moments = np.bincount(kind, height * within, kinds) / np.maximum(np.bincount(kind, height, kinds), _TINY)
    np.multiply(within - moments[kind], slope, out=wider)

    pulse = turn * paddles + paddle
    begins = np.empty(phase.size, dtype=bool)
    np.not_equal(pulse[1:], pulse[:-1], out=begins[1:])
    ends = np.cumsum(lengths)
    begins[ends - lengths] = True
    starts = begins.nonzero()[0]
    counts = np.concatenate((starts[1:], ends[-1:])) - starts
    sizes = _sizes_of_changes(np.add.reduceat(_products(rows), starts, axis=1))
    sizes[:, counts < _LEAST_OF_A_PULSE] = 0.0
    left = left - np.einsum("ij,ij->j", rows[:3], np.repeat(sizes, counts, axis=1))

    found, first_pulse = [], 0
    for length, end, end_pulse in zip(lengths, ends, np.searchsorted(starts, ends), strict=True):
        size, late = sizes[:2, first_pulse + 1 : end_pulse - 1]
        found.append((left[end - length : end], -late[size > _HALF_MISSING]))
        first_pulse = end_pulse
    return found


def _steepness(means_n: Array, steps: Sequence[float]) -> Array:
    """Slopes (w, b) of mean patterns, N per turn. steps: turns between successive samples of each window.

    The difference is taken over the time of a sample, since a sample is a mean over it, and finer bins only add noise.
    """
    bins = means_n.shape[1]
    steepness = np.empty_like(means_n)
    for mean_n, slope, step in zip(means_n, steepness, steps, strict=True):
        apart = max(1, round(0.5 * bins * step))
        around = np.concatenate((mean_n[-apart:], mean_n, mean_n[:apart]))
        np.multiply(0.5 * bins / apart, around[2 * apart :] - around[: -2 * apart], out=slope)
    return steepness


def _products(rows: Array) -> Array:
    """Products for the normal equations, (9, n): squares of rows 0 to 2; rows 0 * 1, 0 * 2, 1 * 2; rows 0 to 2 times row 3."""
    products = np.empty((9, rows.shape[1]))
    np.multiply(rows[:3], rows[:3], out=products[:3])
    np.multiply(rows[0], rows[1:3], out=products[3:5])
    np.multiply(rows[1], rows[2], out=products[5])
    np.multiply(rows[:3], rows[3], out=products[6:])
    return products


def _sizes_of_changes(products: Array) -> Array:
    """Least-squares changes of size, time and width of p pulses, (3, p); 0 if they cannot be separated.

    products: sums of `_products` over each pulse's samples, (9, p). Rows: mean, slope, slope times phase, and residual.
    """
    scale = np.maximum(np.sqrt(products[:3]), _TINY)
    first, second, third = scale
    a, b, c = products[3] / (first * second), products[4] / (first * third), products[5] / (second * third)
    u, v, w = products[6:] / scale
    # Scaled to a unit diagonal; the inverse is symmetric.
    aa, bb, cc, of_ab, of_ac, of_bc = 1.0 - c * c, 1.0 - b * b, 1.0 - a * a, b * c - a, a * c - b, a * b - c
    determinant = aa + a * of_ab + b * of_ac
    known = determinant > _LEAST_DETERMINANT
    solved = np.array([aa * u + of_ab * v + of_ac * w, of_ab * u + bb * v + of_bc * w, of_ac * u + of_bc * v + cc * w])
    return np.where(known, solved / (np.where(known, determinant, 1.0) * scale), 0.0)


def _between(patterns_n: Array, phase: Array, window: NDArray[np.intp]) -> Array:
    """Patterns (p, w, b) at phases (n,) of windows (n,), linearly interpolated between the bins' middles, (p, n)."""
    count, windows, bins = patterns_n.shape
    place = (phase - np.floor(phase)) * bins + 0.5
    before = place.astype(np.intp)
    part = place - before
    around = np.concatenate((patterns_n[..., -1:], patterns_n, patterns_n[..., :1]), axis=2)
    around = around.reshape(count, windows * (bins + 2))
    before += (bins + 2) * window
    low = around.take(before, axis=1)
    return np.asarray(low + part * (around.take(before + 1, axis=1) - low))


def _valleys(means_n: Array, edges: Array) -> Array:
    """Phase (w,) at which `edges` must begin to cut each mean pattern (w, b) where it is lowest."""
    bins = means_n.shape[1]
    broad = max(1, bins // 56)
    sums = np.cumsum(np.concatenate((means_n[:, -broad - 1 :], means_n, means_n[:, :broad]), axis=1), axis=1)
    smooth = sums[:, 2 * broad + 1 :] - sums[:, : -2 * broad - 1]
    cuts = np.rint(edges * bins).astype(np.intp) % bins
    at_edges = sum(np.concatenate((smooth[:, cut:], smooth[:, :cut]), axis=1) for cut in cuts)
    return np.asarray((np.argmin(at_edges, axis=1) + 0.5) / bins)
