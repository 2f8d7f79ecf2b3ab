"""A signal that an amplifier cuts off below the full scale that the machine file states."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.engine.sampling.cut_off import cut_off
from yieldmon.engine.sampling.sample_frames import SampleFrames


def frames(values: np.ndarray) -> SampleFrames:
    """One window of these samples, four to a frame, all usable."""
    samples = np.array(values, dtype=float).reshape(-1, 4)
    count, none = len(samples), np.zeros(1, dtype=np.intp)
    return SampleFrames(
        np.array([0, count]), np.arange(count, dtype=float), samples, np.ones(samples.shape, dtype=bool),
        np.zeros(samples.shape, dtype=bool), np.zeros(count, dtype=bool), none, none, none, np.zeros(1),
    )  # fmt: skip


def pulses(noise_mv: float, step_mv: float, *, height_mv: float = 250.0, width_s: float = 0.01, seed: int = 1) -> np.ndarray:
    """A second of twelve crests that scatter by 7 %, in the steps of a converter."""
    rng, time = np.random.default_rng(seed), np.arange(1000) * 1e-3
    shown = 500.0 + noise_mv * rng.standard_normal(1000)
    for n in range(12):
        size = height_mv * (1.0 + 0.07 * rng.standard_normal())
        shown += size * np.exp(-0.5 * ((time - 0.04 - 0.082 * n) / width_s) ** 2)
    return np.asarray(np.round(shown / step_mv) * step_mv)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("at_mv", [620.0, 650.0, 700.0])
@pytest.mark.parametrize("step_mv", [0.5, 4.0])
def test_crests_that_end_at_one_value_are_cut_off(at_mv: float, step_mv: float, seed: int) -> None:
    shown = np.minimum(pulses(3.0, step_mv, seed=seed), at_mv)
    (count,), (ceiling,) = cut_off(frames(shown))
    assert count == (shown == at_mv).sum() > 20
    assert ceiling == at_mv


def _flat(value: float) -> np.ndarray:
    return np.full(1000, value)


WHOLE = {
    "13 bits": pulses(3.0, 0.5),
    "8 bits": pulses(3.0, 16.0),
    "8 bits without noise": pulses(0.0, 16.0),
    "8 bits, broad crests of one height": pulses(0.0, 16.0, width_s=0.03),
    "8 bits, light pulses": pulses(0.5, 16.0, height_mv=30.0),
    "steady": 500.0 + 100.0 * np.sin(np.arange(1000) * 0.077).round(2),
    "idle": _flat(500.0),
    "idle with noise": np.round(500.0 + 3.0 * np.random.default_rng(2).standard_normal(1000)),
    "two values": np.where(np.arange(1000) % 82 < 60, 700.0, 500.0),
    "stands still after a crest": np.concatenate((pulses(3.0, 0.5)[:500], _flat(800.0)[:500])),
}


@pytest.mark.parametrize("name", WHOLE)
def test_whole_signals_have_no_ceiling(name: str) -> None:
    (count,), (ceiling,) = cut_off(frames(WHOLE[name]))
    assert count == 0
    assert ceiling == 0.0


@pytest.mark.parametrize("seed", range(30))
def test_coarse_steps_are_no_ceiling(seed: int) -> None:
    for width_s in (0.008, 0.02, 0.04):
        for height_mv in (60.0, 150.0, 400.0):
            (count,), _ = cut_off(frames(pulses(0.0, 16.0, height_mv=height_mv, width_s=width_s, seed=seed)))
            assert count == 0
