"""An empirical correction (stop-gap) for a misfit that no effect explains. It only holds in the range of the data.

Relative correction of the fitted model as a Gaussian process over plate angle and fill (and speed where it varied), after
Kennedy and O'Hagan, "Bayesian calibration of computer models", J. R. Stat. Soc. B 63 (2001). Lengths by marginal likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from yieldmon.physics.numerics import Array

from .fit import Fit
from .lack_of_fit import fills

_LENGTHS = (0.25, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Correction:
    """Measured / predicted - 1 as a smooth surface; points (cells, axes) are scaled to about [-1, 1]."""

    axes: tuple[str, ...]
    centre: Array
    spread: Array
    points: Array
    weights: Array
    length: float
    size: float
    closed_pct: float
    """Share of the excess mean square that it explains on cells left out one at a time."""

    def at(self, plate_angle_rad: Array, fill: Array, elevator_speed_rad_s: Array) -> Array:
        """Correction at other conditions; 0 far from the data."""
        columns = {"plate_angle": plate_angle_rad, "fill": fill, "elevator_speed": elevator_speed_rad_s}
        points = (np.stack([columns[a] for a in self.axes], axis=-1) - self.centre) / self.spread
        return _kernel(points, self.points, self.length, self.size) @ self.weights


def correction(fit: Fit) -> Correction:
    """Surface through the residuals of a fit, smoothed according to the noise."""
    cells = fit.frame.cells
    columns = {"plate_angle": cells.plate_angle_rad, "fill": fills(fit), "elevator_speed": cells.elevator_speed_rad_s}
    axes = tuple(name for name, v in columns.items() if np.ptp(v) > 1e-6 * np.max(np.abs(v)))
    raw = np.stack([columns[a] for a in axes], axis=-1)
    centre, spread = 0.5 * (raw.max(axis=0) + raw.min(axis=0)), 0.5 * np.ptp(raw, axis=0)
    points = (raw - centre) / spread
    predicted = cells.mean + fit.residual * fit.frame.sd
    floor = 0.02 * float(np.max(np.abs(predicted)))
    level = np.where(np.abs(predicted) > floor, predicted, floor)
    target, noise = -fit.residual * fit.frame.sd / level, fit.frame.sd / np.abs(level)
    best: tuple[float, float, float] | None = None
    total = float(np.sqrt(np.mean(target**2)))
    for length in _LENGTHS:
        for size in (0.3 * total, total, 3.0 * total):
            factor = np.linalg.cholesky(_kernel(points, points, length, size) + np.diag(noise**2))
            solved = scipy.linalg.cho_solve((factor, True), target)
            value = float(-0.5 * target @ solved - np.sum(np.log(np.diag(factor))))
            if best is None or value > best[0]:
                best = (value, length, size)
    assert best is not None
    _, length, size = best
    inverse = np.linalg.inv(_kernel(points, points, length, size) + np.diag(noise**2))
    weights = inverse @ target
    left_out = weights / np.diag(inverse)
    weight2 = 1.0 / noise**2
    excess = float(np.sum(weight2 * target**2)) - len(target)
    remains = float(np.sum(weight2 * left_out**2)) - len(target)
    closed = 100.0 * (1.0 - max(remains, 0.0) / excess) if excess > 0.0 else 0.0
    return Correction(axes, centre, spread, points, weights, length, size, closed)


def _kernel(a: Array, b: Array, length: float, size: float) -> Array:
    distance2 = np.sum(((a[:, None, :] - b[None, :, :]) / length) ** 2, axis=-1)
    return np.asarray(size**2 * np.exp(-0.5 * distance2))
