"""What the measurement itself scatters: replicates where there are any, else a stated model.

Standard deviation of one row as sqrt(a^2 + (b y)^2) of its level y; b is kept only where the data ask for it (likelihood ratio on
the cells' variances, 5 %).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

from .observations import Cells, Rows, cells

_OUTLIER_SD = 5.0
_MIN_REPLICATE_DOF = 8


@dataclass(frozen=True)
class Noise:
    """sd of one row: sqrt(constant^2 + (proportional y)^2); dof behind it; how it was found ("replicates", "smooth", "stated")."""

    constant: float
    proportional: float
    dof: float
    how: str
    pooled_sd: float
    """One number for all rows, as the classical lack-of-fit test uses."""

    def sd(self, level: Array) -> Array:
        """Standard deviation of one row at reading `level`."""
        return np.sqrt(self.constant**2 + (self.proportional * level) ** 2)


def estimate(rows: Rows) -> tuple[Noise, NDArray[np.bool_]]:
    """Noise, and which rows are outliers: beyond 5 sd of their cell's median (or of the smooth surface), never to be fitted."""
    if np.all(np.isfinite(rows.sigma)) and np.all(rows.sigma > 0.0):
        pooled = float(np.sqrt(np.mean(rows.sigma**2)))
        level = np.abs(rows.value)
        b2 = max(float(np.polyfit(level**2, rows.sigma**2, 1)[0]) if np.ptp(level) > 0.0 else 0.0, 0.0)
        a2 = max(float(np.mean(rows.sigma**2 - b2 * level**2)), 1e-4 * pooled**2)
        return Noise(np.sqrt(a2), np.sqrt(b2), 1e6, "stated", pooled), np.zeros(len(rows), dtype=bool)
    count = np.bincount(rows.cell)
    if len(rows) - len(count) >= _MIN_REPLICATE_DOF:
        return _from_replicates(rows)
    return _from_smooth_surface(rows)


def _from_replicates(rows: Rows) -> tuple[Noise, NDArray[np.bool_]]:
    outlier = np.zeros(len(rows), dtype=bool)
    median = np.array([np.median(rows.value[rows.cell == c]) for c in range(rows.cell.max() + 1)])
    count = np.bincount(rows.cell)
    deviation = rows.value - median[rows.cell]
    repeated = count[rows.cell] > 1
    # A median of absolute deviations is blind to the outliers that it is to find.
    correction = np.sqrt(1.0 - 1.0 / np.maximum(count[rows.cell], 2))
    robust = 1.4826 * np.median(np.abs(deviation[repeated]) / correction[repeated])
    noise = _variance_model(cells(rows.take(~outlier)), robust)
    judged = count[rows.cell] >= 3
    for _ in range(3):
        found = judged & (np.abs(deviation) > _OUTLIER_SD * np.maximum(noise.sd(median[rows.cell]), 1e-300))
        if np.array_equal(found, outlier):
            break
        outlier = found
        noise = _variance_model(cells(rows.take(~outlier)), robust)
    return noise, outlier


def _variance_model(grouped: Cells, robust_sd: float) -> Noise:
    repeated = grouped.count > 1
    dof = grouped.count[repeated] - 1.0
    variance = grouped.scatter[repeated] / dof
    level2 = grouped.mean[repeated] ** 2
    total = float(dof.sum())
    pooled = float((variance * dof).sum() / total)
    if pooled == 0.0:
        pooled = max(robust_sd**2, 1e-12 * float(np.max(np.abs(grouped.mean))) ** 2)
    a2, b2 = fit_variances(variance, dof, level2, pooled)
    return Noise(float(np.sqrt(a2)), float(np.sqrt(b2)), total, "replicates", float(np.sqrt(pooled)))


def fit_variances(variance: Array, dof: Array, level2: Array, pooled: float) -> tuple[float, float]:
    """(a^2, b^2) of variance = a^2 + b^2 level^2 by gamma likelihood; (pooled, 0) unless the data ask for more (5 %)."""
    floor = 0.02 * pooled

    def deviance(model: Array) -> float:
        return float(np.sum(dof * (np.log(model) + variance / model)))

    best = (pooled, 0.0)
    least = deviance(np.full_like(variance, pooled)) - 3.84
    top = float(level2.max())
    if np.ptp(level2) <= 1e-3 * top:
        return best
    for share in np.linspace(0.02, 0.98, 49):
        # `share` of the variance at the top level is proportional; the overall size follows in closed form.
        form = (1.0 - share) + share * level2 / top
        size = float(np.sum(dof * variance / form) / dof.sum())
        value = deviance(np.maximum(size * form, floor))
        if value < least:
            best, least = (max(size * (1.0 - share), floor), size * share / top), value
    return best


def _from_smooth_surface(rows: Rows) -> tuple[Noise, NDArray[np.bool_]]:
    """Scatter about a polynomial surface over angle, load and speed, which no model had a say in."""
    keep = np.ones(len(rows), dtype=bool)
    top = float(np.max(np.abs(rows.value)))
    noise = Noise(0.002 * top, 0.01, 20.0, "stated", 0.01 * top)
    for _ in range(4):
        basis = _surface(rows, int(np.count_nonzero(keep)))
        if basis is None:
            return noise, ~keep
        weight = 1.0 / noise.sd(rows.value)
        coefficients, _, rank, _ = np.linalg.lstsq(basis[keep] * weight[keep, None], rows.value[keep] * weight[keep], rcond=1e-10)
        residual = rows.value - basis @ coefficients
        dof = np.count_nonzero(keep) - int(rank)
        spread = dof / np.count_nonzero(keep)
        variance = residual[keep] ** 2 / spread
        pooled = float(np.mean(variance))
        a2, b2 = fit_variances(variance, np.full(variance.shape, spread), rows.value[keep] ** 2, pooled)
        noise = Noise(float(np.sqrt(a2)), float(np.sqrt(b2)), float(dof), "smooth", float(np.sqrt(pooled)))
        robust = 1.4826 * float(np.median(np.abs(residual[keep]) / noise.sd(rows.value[keep]))) / np.sqrt(spread)
        good = np.abs(residual) <= _OUTLIER_SD * max(min(robust, 1.0), 0.3) * noise.sd(rows.value)
        if np.array_equal(good, keep):
            break
        keep = good
    return noise, ~keep


def _surface(rows: Rows, count: int) -> Array | None:
    axes = (rows.plate_angle_rad, np.sqrt(np.maximum(rows.load, 0.0)), rows.elevator_speed_rad_s)
    scaled, degrees = [], []
    for values, most in zip(axes, (5, 4, 3), strict=True):
        span = float(np.ptp(values))
        levels = len(np.unique(np.round(values / max(span, 1e-300), 3))) if span > 0.0 else 1
        scaled.append((values - values.min()) / span * 2.0 - 1.0 if span > 0.0 else np.zeros(len(values)))
        degrees.append(min(most, levels - 1))
    for total in (7, 6, 5, 4, 3, 2):
        powers = [p for p in product(*(range(d + 1) for d in degrees)) if sum(p) <= total]
        if len(powers) <= 0.5 * count:
            columns = [np.prod([np.polynomial.chebyshev.chebval(s, [0.0] * k + [1.0]) for s, k in zip(scaled, p, strict=True)], axis=0) for p in powers]
            return np.stack(columns, axis=-1)
    return None
