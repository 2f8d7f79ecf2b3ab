"""Signals sampled a few times a second, as functions of time: linear between values, constant after the last."""

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
    """A signal over w windows, linear between knots; arrays (w, k), each row from the window's start to its end."""

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
    """The values of a signal that belong to windows not closed yet, and the value carried into the first of them."""

    def __init__(self, carried: float, rivals: DuplicateSenderWatch) -> None:
        """carried: the value before the first measured one; nan: not known. rivals: detects a second sender."""
        self._carried = carried
        self._rivals = rivals
        self._times: list[float] = []
        self._values: list[float] = []

    def add(self, time_s: float, value: float) -> None:
        """Append a value."""
        self._times.append(time_s)
        self._values.append(value)

    def extend(self, times_s: Sequence[float], values: Sequence[float]) -> None:
        """Append several values."""
        self._times.extend(times_s)
        self._values.extend(values)

    def forget(self) -> None:
        """Discard all values: the signal is unknown until the next one."""
        self._carried = float("nan")
        self._times.clear()
        self._values.clear()

    def take(self, edges: Array) -> tuple[Knots, NDArray[np.bool_], Counts]:
        """The signal in the windows between edges (w + 1,), and remove its values.

        Returns
        -------
        knots : Knots
            (w, k). Before the first value ever, the first value itself is used.
        measured : ndarray of bool
            (w, k), which knots are measured values.
        surplus : ndarray of int
            (w,), values that only a second sender explains.
        """
        starts, ends = edges[:-1, None], edges[1:, None]
        times, values = np.array(self._times), np.array([self._carried, *self._values])
        bounds = bounds_at(times, edges)
        surplus = self._rivals.take(times, values[1:], bounds, edges)
        counts = np.diff(bounds)
        columns = np.arange(int(counts.max()) + 2)
        measured = (columns >= 1) & (columns <= counts[:, None])
        # Column 0 is the value carried in; columns beyond the measured ones repeat the window's last value.
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
