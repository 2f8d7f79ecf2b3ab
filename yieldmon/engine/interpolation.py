"""Signals that come a few times a second, as a function of time: straight from one value to the next, and held after the last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.duplicate_senders import DuplicateSenderWatch
from yieldmon.engine.sampling.segments import Counts, bounds_at
from yieldmon.physics.numerics import Array


@dataclass(frozen=True, slots=True)
class Knots:
    """A signal over w windows, straight between knots; arrays (w, k), each row from a window's start to its end and then held."""

    times: Array
    values: Array

    def at(self, times: Array) -> Array:
        """Values at engine times of any shape."""
        return np.interp(times, self.times.ravel(), self.values.ravel())

    def means(self) -> Array:
        """Means (w,) over the time of each window."""
        parts = 0.5 * (self.values[:, 1:] + self.values[:, :-1]) * np.diff(self.times, axis=1)
        mean: Array = np.cumsum(parts, axis=1)[:, -1] / (self.times[:, -1] - self.times[:, 0])
        return mean


class InterpolatedSignal:
    """Measured values of a signal that wait for their window, and the value carried into it."""

    def __init__(self, carried: float, rivals: DuplicateSenderWatch) -> None:
        """carried: the value before the first that is measured; nan: not known. rivals: judges whether two nodes send it."""
        self._carried = carried
        self._rivals = rivals
        self._times: list[float] = []
        self._values: list[float] = []

    def add(self, time_s: float, value: float) -> None:
        """A value that follows those already there."""
        self._times.append(time_s)
        self._values.append(value)

    def extend(self, times_s: Sequence[float], values: Sequence[float]) -> None:
        """Several of them."""
        self._times.extend(times_s)
        self._values.extend(values)

    def forget(self) -> None:
        """What was measured no longer holds: the value is unknown until the next one."""
        self._carried = float("nan")
        self._times.clear()
        self._values.clear()

    def take(self, edges: Array) -> tuple[Knots, NDArray[np.bool_], Counts]:
        """The knots of the windows between edges, which of them were measured, and how many values of each window a second
        sender accounts for; the values are used up.

        Before the first value ever the first one itself holds.
        """
        starts, ends = edges[:-1, None], edges[1:, None]
        times, values = np.array(self._times), np.array([self._carried, *self._values])
        bounds = bounds_at(times, edges)
        surplus = self._rivals.take(times, values[1:], bounds, edges)
        counts = np.diff(bounds)
        columns = np.arange(int(counts.max()) + 2)
        measured = (columns >= 1) & (columns <= counts[:, None])
        # Column 0 is what was carried in, the last column and those between hold the window's last value.
        places = bounds[:-1, None] + np.minimum(columns, counts[:, None])
        table = values[places]
        unknown = np.isnan(table[:, 0])
        if unknown.any():
            table[unknown, 0] = table[unknown, 1]
        knots = np.broadcast_to(ends, measured.shape).copy()
        knots[:, :1] = starts
        if times.size:
            knots[measured] = times
        knots = np.maximum.accumulate(np.minimum(np.maximum(knots, starts), ends), axis=1)
        self._carried = float(table[-1, -1])
        self._times.clear()
        self._values.clear()
        return Knots(knots, table), measured, surplus
