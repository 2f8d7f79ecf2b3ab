"""Accuracy figures against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.frames import (
    ACCUMULATED_MASS,
    MASS_FLOW,
    NOT_AVAILABLE,
    SELF_CALIBRATION_STATUS,
    EstimateQuality,
    Frame,
    SweepState,
)
from yieldmon.trial.accuracy import assess


def mass_of(true_kg_s):
    """Delivered mass by time for flows that hold for a second each."""
    ends = np.arange(len(true_kg_s) + 1.0)
    mass = np.concatenate(([0.0], np.cumsum(true_kg_s)))
    return lambda time_s: np.interp(time_s, ends, mass)


def flow(time_s, rate, quality=EstimateQuality.OK):
    spread = 0.1 if rate is not NOT_AVAILABLE else NOT_AVAILABLE
    return Frame(time_s, MASS_FLOW, {"MassFlowRate": rate, "MassFlowStdDev": spread, "EstimateQuality": quality})


def test_errors_by_band_and_in_all():
    true = np.array([1.0, 5.0, 10.0, 20.0, 5.0, 0.0])
    published = [
        flow(1.0, 1.5),
        flow(2.0, 5.1),
        flow(3.0, 9.0),
        flow(4.0, 21.0),
        flow(5.0, NOT_AVAILABLE, EstimateQuality.NOT_AVAILABLE),
        flow(6.0, NOT_AVAILABLE, EstimateQuality.NOT_HARVESTING),
        Frame(6.0, ACCUMULATED_MASS, {"TotalMass": 40.0}),
    ]
    found = assess(published, mass_of(true), 0.0, 6.5)
    assert (found.windows, found.rated_windows, found.missing_rated_windows) == (6, 4, 1)
    assert found.mean_abs_pct == pytest.approx((2.0 + 10.0 + 5.0) / 3.0)
    assert found.p95_abs_pct == pytest.approx(np.percentile([2.0, 10.0, 5.0], 95.0))
    assert found.mass_error_pct == pytest.approx(100.0 * (40.0 - 41.0) / 41.0)
    low, _, middle = found.bands[:3]
    assert (low.windows, low.missing, low.bias_kg_s) == (2, 0, pytest.approx(0.25))
    assert (middle.windows, middle.missing, middle.mean_abs_pct) == (2, 1, pytest.approx(2.0))
    assert np.isnan(found.bands[1].bias_kg_s)


def test_saying_not_harvesting_while_grain_flows_is_missing_not_zero():
    idle = flow(1.0, NOT_AVAILABLE, EstimateQuality.NOT_HARVESTING)
    found = assess([idle], mass_of(np.array([6.0])), 0.0, 1.0)
    assert found.missing_rated_windows == 1
    assert np.isnan(found.mean_abs_pct)
    assert found.to_json()["flow_error_pct"]["mean_abs"] is None


def test_sweeps_are_counted_when_they_end():
    states = [
        SweepState.IDLE,
        SweepState.MEASURING,
        SweepState.UPDATED,
        SweepState.UPDATED,
        SweepState.ABORTED,
        SweepState.NOT_LEARNED,
    ]
    frames = [Frame(float(i), SELF_CALIBRATION_STATUS, {"SweepState": s}) for i, s in enumerate(states)]
    found = assess([flow(1.0, 5.0), *frames], mass_of(np.array([5.0])), 0.0, 6.0)
    assert found.sweeps == 2


def test_no_common_second_is_an_error():
    with pytest.raises(ValueError, match="no MassFlow frame"):
        assess([flow(100.0, 5.0)], mass_of(np.array([5.0])), 0.0, 50.0)


def test_a_result_is_compared_with_the_second_that_it_speaks_of():
    true = np.array([4.0, 4.0, 8.0, 8.0, 8.0])
    found = assess([flow(3.25, 8.0), flow(2.75, 6.0)], mass_of(true), 0.25, 5.0)
    assert found.mean_abs_pct == pytest.approx(0.0, abs=1e-9)
