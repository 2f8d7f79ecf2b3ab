"""Whether the residuals of several sweeps show a pattern that the model cannot make, and where.

One sweep's residuals may be a bad sweep; the same pattern over several is the model's. Residuals are averaged over sweeps at each
plate angle; their mean square over what the sweeps' own scatter allows is an F ratio, and the region is the contiguous run of
angles whose normalised sum is largest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from yieldmon.physics.numerics import Array


@dataclass(frozen=True, slots=True)
class SweepResiduals:
    """Residuals of one sweep after its own best fit: model minus measurement over measurement, and their sd; shapes (steps,).

    fitted: number of quantities that the sweep's fit took from these steps.
    """

    plate_angle_rad: Array
    relative_residual: Array
    sd: Array
    fitted: int


@dataclass(frozen=True, slots=True)
class Misfit:
    """disagrees: the common pattern is significant. Region and mean relative error of its strongest run of angles."""

    disagrees: bool
    p_value: float
    plate_angle_rad: tuple[float, float]
    mean_relative_error: float


def common_misfit(
    sweeps: Sequence[SweepResiduals], *, least_sweeps: int = 4, level: float = 0.001, width_rad: float = np.radians(2.0)
) -> Misfit:
    """Test the pattern over plate angle that the sweeps share.

    width_rad: steps closer than this are one angle. Never disagrees on fewer than least_sweeps sweeps. The scatter of the sweeps
    about their common pattern widens the stated sd where it is larger, so that flow that wanders raises no alarm.
    """
    nothing = Misfit(False, 1.0, (np.nan, np.nan), np.nan)
    usable = [s for s in sweeps if len(s.relative_residual) > s.fitted + 1]
    if len(usable) < least_sweeps:
        return nothing
    angle = np.concatenate([s.plate_angle_rad for s in usable])
    residual = np.concatenate([s.relative_residual for s in usable])
    sd = np.concatenate([s.sd for s in usable])
    good = np.isfinite(angle) & np.isfinite(residual) & np.isfinite(sd) & (sd > 0.0)
    angle, residual, sd = angle[good], residual[good], sd[good]
    if angle.size == 0:
        return nothing
    order = np.argsort(angle, kind="stable")
    numbers = np.empty(angle.size, dtype=np.int64)
    numbers[order] = np.concatenate(([0], np.cumsum(np.diff(angle[order]) > width_rad)))
    count = int(numbers.max()) + 1
    weight = np.bincount(numbers, 1.0 / sd**2, count)
    mean = np.bincount(numbers, residual / sd**2, count) / weight
    fitted = float(np.mean([s.fitted for s in usable]))
    within_dof = angle.size - count - (len(usable) - 1) * fitted
    if count <= fitted + 1.0 or within_dof < 3.0:
        return nothing
    scatter = max(float(np.sum(((residual - mean[numbers]) / sd) ** 2)) / within_dof, 1.0)
    between = float(np.sum(mean**2 * weight)) / (count - fitted)
    p_value = float(stats.f.sf(between / scatter, count - fitted, within_dof))
    if p_value >= level:
        return Misfit(False, p_value, (np.nan, np.nan), np.nan)
    first, last = _strongest_run(mean * np.sqrt(weight))
    centre = np.bincount(numbers, angle, count) / np.bincount(numbers, minlength=count)
    inside = slice(first, last + 1)
    error = float(np.sum(mean[inside] * weight[inside]) / np.sum(weight[inside]))
    return Misfit(True, p_value, (float(centre[first]), float(centre[last])), error)


def _strongest_run(whitened: Array) -> tuple[int, int]:
    """First and last cell of the contiguous run with the largest |sum| / sqrt(length)."""
    total = np.concatenate(([0.0], np.cumsum(whitened)))
    best, place = -1.0, (0, 0)
    for first in range(len(whitened)):
        for last in range(first, len(whitened)):
            score = abs(float(total[last + 1] - total[first])) / np.sqrt(last - first + 1.0)
            if score > best:
                best, place = score, (first, last)
    return place
