"""How a window's samples spread over its paddle patterns, on samples whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.engine.sampling.sample_frames import SampleFrames
from yieldmon.engine.sampling.window_spread import scatter


def frames(values: list[float]) -> SampleFrames:
    """One window of these samples, four to a frame, all usable."""
    samples = np.array(values).reshape(-1, 4)
    count, none = len(samples), np.zeros(1, dtype=np.intp)
    return SampleFrames(
        np.array([0, count]), np.arange(count, dtype=float), samples, np.ones(samples.shape, dtype=bool),
        np.zeros(samples.shape, dtype=bool), np.zeros(count, dtype=bool), none, none, none, np.zeros(1),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("patterns", "std_dev", "trend"),
    [
        ([5.0, 5.0, 5.0, 5.0], 0.0, 0.0),
        ([0.0, 0.5, 0.0, 0.5], 0.5**2 * 0.5**0.5, 0.0),
        ([0.0, 0.25, 0.5, 0.75], 0.25 / 8.0**0.5, 8.0**0.5),
        ([1.0, 2.0], np.nan, np.nan),
    ],
    ids=["all the same", "to and fro", "rising", "too few"],
)
def test_scatter_and_trend(patterns: list[float], std_dev: float, trend: float) -> None:
    values = [value for value in patterns for _ in range(8)]
    to_end = np.arange(len(values), 0, -1) / 8.0 - 1e-6
    found, slope, used, means = scatter(frames(values), to_end, np.array([float(len(patterns))]))
    assert found[0] == pytest.approx(std_dev, nan_ok=True)
    assert slope[0] == pytest.approx(trend, nan_ok=True)
    assert used.tolist() == [len(patterns)]
    assert means == [tuple(reversed(patterns))]
