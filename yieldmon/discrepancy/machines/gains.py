"""Gains in chi-square: of a change against what is noise or anybody's, and the largest one that chance gives."""

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
        """(1 + C'C)^-1, of Woodbury's inverse."""
        return np.asarray(np.linalg.inv(np.eye(self.columns.shape[1]) + self.columns.T @ self.columns))

    def length(self, change: Array) -> float:
        """Of a change beside the columns, in standard deviations."""
        inside = self.columns.T @ change
        return float(np.sqrt(np.maximum(change @ change - inside @ self.inner @ inside, 0.0)))

    def without(self, change: Array, error: Array) -> tuple[float, float]:
        """Chi-square less a change whose law may be off by columns of error, and the log determinant that those add."""
        left = np.concatenate(((self.residual - change)[:, None], error), axis=1)
        inside = self.columns.T @ left
        gram = left.T @ left - inside.T @ self.inner @ inside
        small = np.eye(error.shape[1]) + gram[1:, 1:]
        chi2 = gram[0, 0] - gram[0, 1:] @ np.linalg.solve(small, gram[0, 1:])
        return float(chi2), float(np.linalg.slogdet(small)[1])


@dataclass(frozen=True)
class LargestGains:
    """Largest gains of alike machines, ascending; beyond what was drawn, the tail of chi-square with one degree of freedom."""

    largest: Array

    def p_value(self, gain: float) -> float:
        """Probability of so large a gain at a machine like the others."""
        drawn = len(self.largest)
        joint = self.largest[int(0.95 * drawn)]
        if gain <= joint:
            return float((1 + drawn - np.searchsorted(self.largest, gain)) / (1 + drawn))
        return float(0.05 * scipy.stats.chi2.sf(gain, 1) / scipy.stats.chi2.sf(joint, 1))

    def limit(self, p_value: float) -> float:
        """Gain with that p value, which is below 0.05."""
        joint = self.largest[int(0.95 * len(self.largest))]
        return float(scipy.stats.chi2.isf(p_value / 0.05 * scipy.stats.chi2.sf(joint, 1), 1))
