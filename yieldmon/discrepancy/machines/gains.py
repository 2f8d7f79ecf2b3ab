"""Gains in chi-square by a change beyond noise and common errors, and the distribution of the largest gain by chance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from yieldmon.physics.numerics import Array


@dataclass(frozen=True)
class Residual:
    """A machine's whitened residual (visits,) with noise of unit variance and columns (visits, columns) with unit weights."""

    residual: Array
    columns: Array

    @cached_property
    def inner(self) -> Array:
        """(1 + C'C)^-1 of Woodbury's formula."""
        return np.asarray(np.linalg.inv(np.eye(self.columns.shape[1]) + self.columns.T @ self.columns))

    def length(self, change: Array) -> float:
        """Length of a change beyond the columns, in standard deviations."""
        inside = self.columns.T @ change
        return float(np.sqrt(np.maximum(change @ change - inside @ self.inner @ inside, 0.0)))

    def without(self, change: Array, error: Array) -> tuple[float, float]:
        """Chi-square after a change whose law has errors along some columns, and the log determinant that these add."""
        left = np.concatenate(((self.residual - change)[:, None], error), axis=1)
        inside = self.columns.T @ left
        gram = left.T @ left - inside.T @ self.inner @ inside
        small = np.eye(error.shape[1]) + gram[1:, 1:]
        chi2 = gram[0, 0] - gram[0, 1:] @ np.linalg.solve(small, gram[0, 1:])
        return float(chi2), float(np.linalg.slogdet(small)[1])


@dataclass(frozen=True)
class LargestGains:
    """Largest gains of equal machines, ascending; beyond the random sample the tail of chi-square with one degree of freedom is
    used."""

    largest: Array

    def p_value(self, gain: float) -> float:
        """Probability of such a large gain at a machine equal to the others."""
        drawn = len(self.largest)
        joint = self.largest[int(0.95 * drawn)]
        if gain <= joint:
            return float((1 + drawn - np.searchsorted(self.largest, gain)) / (1 + drawn))
        return float(0.05 * scipy.stats.chi2.sf(gain, 1) / scipy.stats.chi2.sf(joint, 1))

    def limit(self, p_value: float) -> float:
        """Gain with that p value, which is below 0.05."""
        joint = self.largest[int(0.95 * len(self.largest))]
        return float(scipy.stats.chi2.isf(p_value / 0.05 * scipy.stats.chi2.sf(joint, 1), 1))
