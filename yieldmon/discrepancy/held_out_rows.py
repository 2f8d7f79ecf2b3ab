"""Misfit of the held-out rows with and without the effects that were found."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from yieldmon.estimation import model_error
from yieldmon.estimation.gaussian import REACH_95
from yieldmon.physics.numerics import Array

from .diagnosis_result import HeldOut, Measure, share_closed_pct
from .fit import Fit
from .noise import Noise
from .observations import Rows
from .validation import Share, mean_square_interval, share

_FAR_SD = 8.0
"""Deviation from both models, in standard deviations, beyond which a row may be an outlier."""
_OFF_CELL_SD = 5.0
"""Deviation from the median of its repetitions, in standard deviations, beyond which a repeated row is an outlier."""
_REPLICATES = 3
"""Least number of repetitions for which the median of a condition identifies an outlier."""


def score_held_out(
    rows: Rows, is_held_out: NDArray[np.bool_], base: Fit, best: Fit, noise: Noise
) -> tuple[HeldOut | None, NDArray[np.bool_]]:
    """Score two fits on rows that neither was fitted to.

    Parameters
    ----------
    rows : Rows
        All rows.
    is_held_out : ndarray of bool
        (rows,) Which rows are held out.
    base, best : Fit
        Fits without and with the effects that were found, to the other rows.
    noise : Noise
        Noise of the other rows.

    Returns
    -------
    held_out : HeldOut or None
        None if no held-out row can be used.
    outlying : ndarray of bool
        (rows,) Held-out rows that are left out as outliers.
    """
    outlying = np.zeros(len(rows), dtype=bool)
    if not np.any(is_held_out):
        return None, outlying
    kept = rows.take(is_held_out)
    before, after = base.predict(kept), best.predict(kept)
    sd = noise.of_rows(kept, after)
    contradicted = _contradicted(kept, before, after, sd)
    usable = np.isfinite(before) & np.isfinite(after) & ~contradicted
    outlying[np.flatnonzero(is_held_out)[contradicted]] = True
    if not np.any(usable):
        return None, outlying
    top = float(np.max(np.abs(rows.value)))
    rms = [float(np.sqrt(np.mean((p[usable] - kept.value[usable]) ** 2))) for p in (before, after)]
    floor = float(np.sqrt(np.mean(sd[usable] ** 2)))
    whitened = [(p[usable] - kept.value[usable]) / sd[usable] for p in (before, after)]
    square = [float(np.mean(r**2)) for r in whitened]
    count = int(usable.sum())
    measures = [
        Measure(v, 100.0 * v / top, f, float(scipy.stats.chi2.sf(f * count, count))) for v, f in zip(rms, square, strict=True)
    ]
    error = base.frame.model_error * model_error.basis(
        kept.plate_angle_rad[usable], kept.load[usable], kept.elevator_speed_rad_s[usable]
    )
    error = error * (model_error.level(after[usable]) / sd[usable])[:, None]
    found = share(whitened[0], whitened[1], error)
    held_out = HeldOut(
        rows=count,
        before=measures[0],
        after=measures[1],
        noise_floor_rms=floor,
        closed_pct=share_closed_pct(rms[0], rms[1], floor),
        closed_interval_pct=_closed_interval_pct(found, square[0], count),
        f_interval=(mean_square_interval(square[0], count), mean_square_interval(square[1], count)),
        share=found,
    )
    return held_out, outlying


def _contradicted(kept: Rows, before: Array, after: Array, sd: Array) -> NDArray[np.bool_]:
    """Rows with the same large deviation from both models, which is attributed to the sensor."""
    with np.errstate(invalid="ignore"):
        nearest = np.minimum(np.abs(before - kept.value), np.abs(after - kept.value))
    same_cell = np.array([np.median(kept.value[kept.cell == c]) for c in kept.cell])
    unreplicated = np.array([np.count_nonzero(kept.cell == c) for c in kept.cell]) < _REPLICATES
    return np.asarray((nearest > _FAR_SD * sd) & (unreplicated | (np.abs(kept.value - same_cell) > _OFF_CELL_SD * sd)))


def _closed_interval_pct(found: Share, square_before: float, count: int) -> tuple[float, float] | None:
    """95 % interval of the removed share of the misfit. square_before: mean square of the whitened residuals before."""
    if not (found.power > 0.0 and square_before > 1.0):
        return None
    low, high = (
        (2.0 * (found.value + s * found.sd) - 1.0) * found.power / (count * (square_before - 1.0)) for s in (-REACH_95, REACH_95)
    )
    return 100.0 * low, 100.0 * high
