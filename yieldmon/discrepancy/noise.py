"""Noise of the measurements, from repetitions if there are any, else from a model.

Standard deviation of one row as sqrt(a^2 + (b y)^2) of its level y; b is kept only where the data ask for it (likelihood ratio on
the cells' variances, 5 %). Rows that state their own standard deviation keep it; the law of the level is then for rows to come.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy
from numpy.typing import NDArray

from yieldmon.estimation.fitting.scatter_law import (
    LEAST_PURE_DOF,
    OUTLIER_SDS,
    either_form,
    fit_variances,
    medians,
    rounding_sd,
    scatter_law,
    scattering,
    usual_deviation,
)
from yieldmon.estimation.gaussian import SD_PER_MAD
from yieldmon.physics.numerics import Array

from .observations import Cells, Rows, cells

_LEAST_REPLICATE_DOF = 3
"""Sufficient if the rows are too few for a smooth surface."""
_STATED_DOF = 1e6
"""Degrees of freedom of a stated noise, which is assumed to be known."""
_REFUTED = 0.001
"""p value below which repetitions contradict the stated standard deviations of the rows."""
_ASSUMED = (0.002, 0.01)
"""Assumed standard deviation, relative to the largest reading and to each, if the rows do not determine it."""


@dataclass(frozen=True)
class Noise:
    """sd of one row: sqrt(constant^2 + (proportional y)^2), with dof behind it.

    how: "replicates", "smooth", "stated" or "assumed". shared: the part of the constant that repetitions have in common.
    times: factor on the rows' own standard deviations, if repetitions scatter more than these.
    """

    constant: float
    proportional: float
    dof: float
    how: str
    shared: float = 0.0
    times: float = 1.0

    def sd(self, level: Array) -> Array:
        """Standard deviation of one row at reading `level`."""
        return np.sqrt(self.constant**2 + (self.proportional * level) ** 2)

    def of_rows(self, rows: Rows, level: Array) -> Array:
        """Standard deviation of each row, (rows,): the stated one if there is any, else that of its `level`."""
        return self.times * rows.sigma if rows.stated else self.sd(level)

    def of_cells(self, grouped: Cells) -> Array:
        """Standard deviation of each cell's mean, shape (cells,)."""
        if grouped.rows.stated:
            return np.asarray(self.times * np.bincount(grouped.rows.cell, grouped.rows.sigma**-2.0) ** -0.5)
        own = self.sd(grouped.mean) / np.sqrt(grouped.count)
        return own if self.shared == 0.0 else np.hypot(own, self.shared * np.sqrt(1.0 - 1.0 / grouped.count))


def estimate(rows: Rows) -> tuple[Noise, NDArray[np.bool_]]:
    """Noise, and which rows are outliers: more than 5 sd from their cell's median (or the smooth surface); they are never
    fitted."""
    if rows.stated:
        times, dof = _beyond_stated(rows)
        return Noise(*scatter_law(rows.value, times * rows.sigma), dof, "stated", times=times), np.zeros(len(rows), dtype=bool)
    count = np.bincount(rows.cell)
    if len(rows) - len(count) >= LEAST_PURE_DOF:
        return _from_replicates(rows)
    return _from_smooth_surface(rows)


def _beyond_stated(rows: Rows) -> tuple[float, float]:
    """Ratio of the scatter of repetitions to the stated standard deviations of rows, and its degrees of freedom. The ratio is 1
    if chance explains it, or few rows repeat. Outliers do not count."""
    count = np.bincount(rows.cell)
    dof = len(rows) - len(count)
    if dof < LEAST_PURE_DOF:
        return 1.0, _STATED_DOF
    weight = rows.sigma**-2.0
    mean = (np.bincount(rows.cell, weight * rows.value) / np.bincount(rows.cell, weight))[rows.cell]
    repeated = (count > 1)[rows.cell]
    off = (np.abs(rows.value - mean) / rows.sigma)[repeated]
    alike = off / np.sqrt(1.0 - 1.0 / count[rows.cell][repeated])
    kept = alike <= OUTLIER_SDS * max(usual_deviation(alike), 1.0)
    left, square = dof * float(np.mean(kept)), float(np.sum(off[kept] ** 2))
    refuted = left > 0.0 and scipy.special.chdtrc(left, square) < _REFUTED
    return (float(np.sqrt(square / left)), left) if refuted else (1.0, _STATED_DOF)


def _from_replicates(rows: Rows) -> tuple[Noise, NDArray[np.bool_]]:
    count = np.bincount(rows.cell)[rows.cell]
    repeated = count > 1
    median = medians(rows.value, rows.cell)[rows.cell]
    deviation = np.abs(rows.value - median) / np.sqrt(1.0 - 1.0 / np.maximum(count, 2))
    form = either_form(median)
    counted = repeated & scattering(rows.value, rows.cell)
    robust, rounding = usual_deviation((deviation / form)[counted if counted.any() else repeated]), rounding_sd(rows.value)
    sd = np.maximum(2.0 * max(robust, 1e-12) * form, rounding)
    outlier = _outliers_of_cells(rows, repeated & (deviation > OUTLIER_SDS * sd), sd)
    noise = _rounded(_variance_model(cells(rows.take(~outlier)), robust * float(form.mean())), rounding)
    for _ in range(4):
        sd = np.maximum(noise.sd(median), 1e-300)
        found = _outliers_of_cells(rows, repeated & (deviation > OUTLIER_SDS * sd), sd)
        if np.array_equal(found, outlier):
            break
        outlier = found
        noise = _rounded(_variance_model(cells(rows.take(~outlier)), robust * float(form.mean())), rounding)
    return noise, outlier


def _rounded(noise: Noise, rounding: float) -> Noise:
    """The noise, at least that of rounding. Readings in coarse steps may repeat exactly, but neither they nor their mean are more
    accurate because of it."""
    return noise if rounding <= noise.constant else replace(noise, constant=rounding, shared=rounding)


def _outliers_of_cells(rows: Rows, suspect: NDArray[np.bool_], sd: Array) -> NDArray[np.bool_]:
    """The outliers of cells that contain suspects.

    With few repetitions the majority of a cell may be wrong. Therefore the row nearest to a smooth surface through the cells
    without suspects is assumed to be right (against a majority only if it is five times nearer), and rows that contradict it are
    outliers.
    """
    count = np.bincount(rows.cell)[rows.cell]
    out = suspect & (count > 4)
    doubtful = np.unique(rows.cell[suspect & (count <= 4)])
    if doubtful.size == 0:
        return out
    good = ~np.isin(rows.cell, rows.cell[suspect])
    basis = _surface(rows, len(np.unique(rows.cell[good])))
    if basis is None:
        return suspect
    weight = 1.0 / sd[good]
    surface = basis @ np.linalg.lstsq(basis[good] * weight[:, None], rows.value[good] * weight, rcond=1e-10)[0]
    for number in doubtful:
        places = np.flatnonzero(rows.cell == number)
        off = np.abs(rows.value[places] - surface[places])
        middle = np.argsort(rows.value[places])[(len(places) - 1) // 2]
        trusted = places[middle if len(places) > 2 and off.min() > 0.2 * off[middle] else np.argmin(off)]
        out[places] = np.abs(rows.value[places] - rows.value[trusted]) > OUTLIER_SDS * np.sqrt(2.0) * sd[places]
    return out


def _variance_model(grouped: Cells, robust_sd: float) -> Noise:
    scatters = scattering(grouped.rows.value, grouped.rows.cell)
    repeated = (grouped.count > 1) & (np.bincount(grouped.rows.cell, scatters) > 0.0)
    if not repeated.any():
        repeated = grouped.count > 1
    dof = grouped.count[repeated] - 1.0
    variance = grouped.scatter[repeated] / dof
    level2 = grouped.mean[repeated] ** 2
    total = float(dof.sum())
    pooled = float((variance * dof).sum() / total)
    if pooled == 0.0:
        pooled = max(robust_sd**2, 1e-12 * float(np.max(np.abs(grouped.mean))) ** 2)
    a2, b2 = fit_variances(variance, dof, level2, pooled)
    return Noise(float(np.sqrt(a2)), float(np.sqrt(b2)), total, "replicates")


def _from_smooth_surface(rows: Rows) -> tuple[Noise, NDArray[np.bool_]]:
    """Scatter about a polynomial surface over angle, load, speed and moisture, independent of any model."""
    keep = np.ones(len(rows), dtype=bool)
    top = float(np.max(np.abs(rows.value)))
    noise = Noise(_ASSUMED[0] * top, _ASSUMED[1], 20.0, "assumed")
    for _ in range(4):
        basis = _surface(rows, len(np.unique(rows.cell[keep])))
        if basis is None and noise.how == "assumed" and len(rows) - int(rows.cell.max() + 1) >= _LEAST_REPLICATE_DOF:
            return _from_replicates(rows)
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
        noise = _rounded(Noise(float(np.sqrt(a2)), float(np.sqrt(b2)), float(dof), "smooth"), rounding_sd(rows.value))
        robust = SD_PER_MAD * float(np.median(np.abs(residual[keep]) / noise.sd(rows.value[keep]))) / np.sqrt(spread)
        good = np.abs(residual) <= OUTLIER_SDS * max(min(robust, 1.0), 0.3) * noise.sd(rows.value)
        if np.array_equal(good, keep):
            break
        keep = good
    return noise, ~keep


def _surface(rows: Rows, count: int) -> Array | None:
    axes = [rows.plate_angle_rad, np.sqrt(np.maximum(rows.load, 0.0)), rows.elevator_speed_rad_s]
    if np.all(np.isfinite(rows.moisture_pct)):
        axes.append(rows.moisture_pct)
    scaled, degrees = [], []
    for values, most in zip(axes, (5, 4, 3, 2), strict=False):
        span = float(np.ptp(values))
        levels = len(np.unique(np.round(values / max(span, 1e-300), 3))) if span > 0.0 else 1
        scaled.append((values - values.min()) / span * 2.0 - 1.0 if span > 0.0 else np.zeros(len(values)))
        degrees.append(min(most, levels - 1))
    for total in (7, 6, 5, 4, 3, 2):
        powers = [p for p in product(*(range(d + 1) for d in degrees)) if sum(p) <= total]
        if len(powers) <= 0.5 * count:
            columns = [
                np.prod([np.polynomial.chebyshev.chebval(s, [0.0] * k + [1.0]) for s, k in zip(scaled, p, strict=True)], axis=0)
                for p in powers
            ]
            return np.stack(columns, axis=-1)
    return None
