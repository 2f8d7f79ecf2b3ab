"""Spread of a window's samples: from one paddle pattern to the next, between the halves, and their range."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.sampling import segments
from yieldmon.engine.sampling.sample_frames import SampleFrames
from yieldmon.engine.sampling.segments import Counts
from yieldmon.physics.numerics import Array


def scatter(frames: SampleFrames, to_end: Array, passed: Array) -> tuple[Array, Array, Counts, list[tuple[float, ...]]]:
    """Standard deviation of the mean from differences of neighbouring patterns, the trend, the patterns used, each (w,), and the
    means of these.

    to_end (m,): phase from each sample to its window's end. passed (w,): patterns that pass in each window.
    """
    sizes = frames.frames
    counts = passed.astype(np.intp)
    most = max(1, int(counts.max()))
    samples = np.diff(frames.sample_bounds)
    cell = np.floor(to_end).astype(np.intp)
    outside = (cell < 0) | (cell >= np.repeat(counts, samples))
    if not frames.clean:
        outside |= ~frames.usable.ravel()
    cell += np.repeat(np.arange(sizes.size) * most, samples)
    # What is in no whole pattern goes to a cell of its own.
    cells = sizes.size * most
    cell[outside] = cells
    members = np.bincount(cell, minlength=cells + 1)[:-1].reshape(-1, most)
    sums = np.bincount(cell, weights=frames.samples.ravel(), minlength=cells + 1)[:-1].reshape(-1, most)
    full = (members > 0) & (members >= 0.5 * members.max(axis=1, keepdims=True))
    means, used = sums[full] / members[full], np.count_nonzero(full, axis=1)
    std_dev, trend, used = _scatter_of_patterns(means, used)
    every, stops = means.tolist(), np.cumsum(used).tolist()
    return std_dev, trend, used, [tuple(every[first:last]) for first, last in zip([0, *stops], stops, strict=False)]


def _scatter_of_patterns(means: Array, used: Counts) -> tuple[Array, Array, Counts]:
    """means: of the patterns of one window after another, `used` (w,) of each."""
    std_dev, trend = np.full(used.size, np.nan), np.full(used.size, np.nan)
    enough = used >= 3
    if enough.any():
        stops = np.cumsum(used)[enough]
        patterns = used[enough]
        starts = stops - patterns
        half = patterns // 2
        squares = np.append(np.square(np.diff(means)), 0.0)
        variance = segments.sum_between(squares, starts, stops - 1) / (2.0 * (patterns - 1))
        padded = np.append(means, 0.0)
        first = segments.sum_between(padded, starts, starts + half)
        difference = (first - segments.sum_between(padded, stops - half, stops)) / half
        error = np.sqrt(2.0 * variance / half)
        with np.errstate(divide="ignore", invalid="ignore"):
            trend[enough] = np.where(error > 0.0, np.abs(difference) / error, 0.0)
        std_dev[enough] = np.sqrt(variance / patterns)
    return std_dev, trend, used


def extremes(frames: SampleFrames) -> tuple[Array, Counts, Counts]:
    """Largest less smallest sample (nan without any), samples at the end that equal the last one, and samples, each (w,)."""
    values, bounds = frames.samples.ravel(), frames.sample_bounds
    if not frames.clean:
        return _extremes_of_some(values, frames.usable.ravel(), bounds)
    samples: Counts = np.diff(bounds)
    high, low = segments.reduce(np.maximum, values, bounds, -np.inf), segments.reduce(np.minimum, values, bounds, np.inf)
    held = np.zeros_like(samples)
    for window, (first, last) in enumerate(zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)):
        if last - first > 1 and values[last - 2] != values[last - 1]:
            held[window] = 1
        elif last > first:
            moves = np.flatnonzero(values[first:last] != values[last - 1])
            held[window] = last - first - (int(moves[-1]) + 1 if moves.size else 0)
    with np.errstate(invalid="ignore"):
        return np.where(samples > 0, high - low, np.nan), held, samples


def _extremes_of_some(values: Array, usable: NDArray[np.bool_], bounds: Counts) -> tuple[Array, Counts, Counts]:
    """The same where only some samples are usable."""
    samples = segments.count(usable, bounds)
    high = segments.reduce(np.maximum, np.where(usable, values, -np.inf), bounds, -np.inf)
    low = segments.reduce(np.minimum, np.where(usable, values, np.inf), bounds, np.inf)
    places = np.arange(values.size)
    last = segments.reduce(np.maximum, np.where(usable, places, -1), bounds, -1)
    at_end = np.append(values, 0.0)[last]
    moves = usable & (values != np.repeat(at_end, np.diff(bounds)))
    moved = segments.reduce(np.maximum, np.where(moves, places, -1), bounds, -1)
    ordinal = np.concatenate(([0], np.cumsum(usable)))
    since = np.where(moved >= 0, moved + 1, bounds[:-1])
    held = ordinal[bounds[1:]] - ordinal[since]
    with np.errstate(invalid="ignore"):
        return np.where(samples > 0, high - low, np.nan), held, samples
