"""Time constants from taps, on a spring, damper and mass that scipy integrates after the blow of a half sine."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from yieldmon.estimation.waveform.tap_response import tap_response

STEP_S = 5e-5


def struck(
    tau_s: float, *, damping: float = 1.0, taps: int = 8, apart_s: float = 0.4, interval_s: float = 1e-3, contact_s: float = 5e-4,
    height_mv: float = 900.0, seed: int = 3,
) -> np.ndarray:  # fmt: skip
    """Samples of taps of unlike force, 500 mV at rest, 3 mV of noise; natural frequency 1 / tau."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, apart_s * (taps + 1), STEP_S)
    blow = np.zeros(times.size)
    for k in range(taps):
        begin = apart_s * (k + 0.5) + rng.uniform(0.0, interval_s)
        on = (times >= begin) & (times < begin + contact_s)
        blow[on] += rng.uniform(0.5, 1.0) * np.sin(np.pi * (times[on] - begin) / contact_s)
    w = 1.0 / tau_s
    system = StateSpace([[0.0, 1.0], [-w * w, -2.0 * damping * w]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    _, answer, _ = lsim(system, blow, times)
    answer = 500.0 + height_mv * answer / answer.max()
    samples = answer[:: round(interval_s / STEP_S)]
    return samples + 3.0 * rng.standard_normal(samples.size)


@pytest.mark.parametrize("tau_s", [0.002, 0.005, 0.008, 0.015])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_time_constant_is_found_within_its_deviation(tau_s, sign):
    samples = 500.0 + sign * (struck(tau_s, seed=11) - 500.0)
    found = tap_response([samples], 1e-3, full_scale_mv=4000.0)
    assert found.refused == ""
    assert found.each_s.size == 8
    assert found.response_s == pytest.approx(tau_s, rel=0.05)
    assert abs(found.response_s - tau_s) < 3.0 * found.std_dev_s
    assert found.std_dev_s < 0.03 * tau_s
    assert found.misfit < 0.03


def test_sparser_samples_still_suffice():
    found = tap_response([struck(0.008, interval_s=4e-3, taps=12)], 4e-3, full_scale_mv=4000.0)
    assert found.response_s == pytest.approx(0.008, rel=0.08)
    assert abs(found.response_s - 0.008) < 4.0 * found.std_dev_s


def test_a_plate_that_rings_is_refused_with_its_frequency():
    found = tap_response([struck(0.004, damping=0.08)], 1e-3, full_scale_mv=4000.0)
    [hz] = re.findall(r"do not answer a tap .*, most of that at (\d+) Hz$", found.refused)
    assert float(hz) == pytest.approx(1.0 / (2.0 * np.pi * 0.004), rel=0.15)


def test_a_cell_faster_than_the_samples_is_refused():
    found = tap_response([struck(0.0004)], 4e-3, full_scale_mv=4000.0)
    assert "faster samples would show it" in found.refused


def test_taps_that_do_not_count_are_reported_by_reason():
    hard, close = struck(0.008, height_mv=3900.0, seed=5), struck(0.008, apart_s=0.2, seed=6)
    found = tap_response([struck(0.008), hard, close], 1e-3, full_scale_mv=4000.0)
    assert found.left_out["beyond the sensor's range"] >= 1
    assert found.left_out["too close to another"] == 8
    assert found.response_s == pytest.approx(0.008, rel=0.05)


@pytest.mark.parametrize(
    "samples", [np.full(5000, 500.0), 500.0 + 3.0 * np.random.default_rng(1).standard_normal(5000), np.ones(3)]
)
def test_nothing_struck_is_no_answer(samples):
    with pytest.raises(ValueError, match="0 taps that count"):
        tap_response([samples], 1e-3, full_scale_mv=4000.0)
