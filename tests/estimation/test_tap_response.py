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


def averaged(response: np.ndarray, taps: int = 10, seed: int = 9) -> np.ndarray:
    """Samples of taps at 1 kHz, 500 mV at rest, 3 mV of noise; response: to a blow at its first entry, in steps of `STEP_S`. Each
    sample is the mean of its interval."""
    rng, each, apart = np.random.default_rng(seed), round(1e-3 / STEP_S), round(0.5 / STEP_S)
    force = np.zeros(apart * (taps + 1))
    for k in range(taps):
        begin = apart * k + apart // 2 + int(rng.integers(each))
        force[begin : begin + response.size] += rng.uniform(0.5, 1.0) * response
    samples = force.reshape(-1, each).mean(axis=1)
    return 500.0 + 900.0 * samples / samples.max() + 3.0 * rng.standard_normal(samples.size)


def second_order(tau_s: float, damping: float) -> np.ndarray:
    w, times = 1.0 / tau_s, np.arange(0.0, 20.0 * tau_s, STEP_S)
    roots = np.roots([1.0, 2.0 * damping * w, w * w])
    return np.real((np.exp(roots[0] * times) - np.exp(roots[1] * times)) / (roots[0] - roots[1]))


@pytest.mark.parametrize(
    "response",
    [
        pytest.param(np.exp(-np.arange(0.0, 0.1, STEP_S) / 0.003), id="first order, 3 ms"),
        pytest.param(np.exp(-np.arange(0.0, 0.2, STEP_S) / 0.008), id="first order, 8 ms"),
        pytest.param(second_order(0.002, 0.7), id="2 ms, damping 0.7"),
        pytest.param(second_order(0.008, 0.7), id="8 ms, damping 0.7"),
        pytest.param(second_order(0.003, 2.0), id="3 ms, damping 2"),
    ],
)
def test_a_cell_of_another_response_is_refused(response):
    found = tap_response([averaged(response)], 1e-3, full_scale_mv=4000.0)
    assert "do not answer a tap as a critically damped cell does" in found.refused


@pytest.mark.parametrize("tau_s", [0.002, 0.003, 0.008, 0.015])
def test_averages_of_a_critically_damped_cell_are_not_refused(tau_s):
    found = tap_response([averaged(second_order(tau_s, 1.0 + 1e-6))], 1e-3, full_scale_mv=4000.0)
    assert found.refused == ""
    assert found.response_s == pytest.approx(tau_s, rel=0.06)


def test_taps_that_a_gap_cuts_off_are_counted():
    samples = struck(0.008)
    first = int(np.argmax(samples[:400]))
    found = tap_response([samples[: first + 60], samples[first + 62 :]], 1e-3, full_scale_mv=4000.0)
    assert found.left_out == {"cut off by a gap in the samples or the log's end": 1}


def test_taps_that_are_too_weak_are_told_what_they_lack():
    with pytest.raises(
        ValueError, match=r"^0 taps that count; no sample is further than \d+\.\d mV from rest, and 6\d\.\d mV is 20 times"
    ):
        tap_response([struck(0.008, height_mv=40.0)], 1e-3, full_scale_mv=4000.0)


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
