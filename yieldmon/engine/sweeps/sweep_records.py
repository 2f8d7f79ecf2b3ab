"""Window records as inputs of self-calibration: the rows of a sweep, median moisture and density of the grain."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import isfinite

import numpy as np

from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.records import WindowRecord
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop_inputs import SWEEP_COLUMNS, MeasuredDensity, Sweep


def sweep_of(records: Sequence[WindowRecord]) -> Sweep:
    """The records that have force, angle and speed, as columns; their mean moisture where all of them have one.

    Raises ValueError where none has them."""
    rows = [
        r
        for r in records
        if isfinite(r.force_n) and isfinite(r.plate_angle_rad) and isfinite(r.elevator_speed_rad_s) and r.force_std_dev_n > 0.0
    ]
    if not rows:
        raise ValueError("the sweep has no window with force, angle and speed")
    column = {name: np.array([getattr(r, name) for r in rows]) for name in SWEEP_COLUMNS}
    moisture = column.pop("moisture_pct")
    # The grain does not change within a sweep, and scatter of the moisture reading would be fitted as friction.
    same = np.full(moisture.shape, np.mean(moisture)) if np.all(np.isfinite(moisture)) else None
    return replace(Sweep(**column), moisture_pct=same)


def median_moisture_pct(records: Sequence[WindowRecord]) -> float:
    """Wet basis, %; nan where no record has it."""
    return _median(r.moisture_pct for r in records)


def measured_density(
    records: Sequence[WindowRecord], prior: ParameterSet, settings: CalibratorSettings
) -> MeasuredDensity | None:
    """Paddle density by the records' median test weight; None where it is not measured or not to be used."""
    weight = _median(r.test_weight_kg_m3 for r in records)
    if settings.density_ratio is None or not isfinite(weight) or "density" not in prior.covariance_names:
        return None
    return MeasuredDensity.from_test_weight(
        weight,
        settings.test_weight_std_dev_kg_m3,
        settings.density_ratio,
        settings.density_ratio_std_dev,
    )


def _median(values: Iterable[float]) -> float:
    """Of the finite values; nan where there is none."""
    known = [v for v in values if isfinite(v)]
    return float(np.median(known)) if known else float("nan")
