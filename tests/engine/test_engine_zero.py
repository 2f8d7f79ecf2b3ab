"""The zero follows drift, and stands still under a trickle of grain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from engine_bench import Bench, feed, monitor, only

from studies.waveform.frame_runs import run_of
from yieldmon import frames as bus
from yieldmon.engine.faults import FaultCode
from yieldmon.frames import EstimateQuality, Frame, OperatingState

SHAKING = Bench(noise_mv=5.0, shaft_vibration_mv=7.0, paddle_vibration_mv=7.0, scatter=0.1)
"""Electrical noise, shaft vibration and vibration in step with the paddles, 3 N each."""


def zeros(bench: Bench, seconds: float) -> np.ndarray:
    """Zero after each window, mV; nan while there is none. Fed as a run, which gives the same bits (test_engine_runs)."""
    target = monitor()
    target.feed_run(bench.run(seconds))
    return np.array([record.zero_mv for record in target.records])


def after(start_s: float, rate: float):
    return lambda t: rate if t >= 1000.0 + start_s else 0.0


@pytest.mark.parametrize("bench", [Bench(), SHAKING, replace(SHAKING, rpm=lambda t: 330.0)], ids=["quiet", "shaking", "330 rpm"])
def test_first_zero_comes_with_the_third_empty_second(bench: Bench) -> None:
    found = zeros(bench, 20)
    assert np.isnan(found[:2]).all()
    assert found[2:] == pytest.approx(150.0, abs=0.4)


@pytest.mark.parametrize("bench", [Bench(), SHAKING], ids=["quiet", "shaking"])
def test_drift_is_followed(bench: Bench) -> None:
    found = zeros(replace(bench, zero=lambda t: 150.0 + 0.02 * (t - 1000.0)), 160)
    true = 150.0 + 0.02 * np.arange(1, found.size + 1)
    assert found[60:] == pytest.approx(true[60:], abs=1.0)


@pytest.mark.parametrize(
    ("bench", "rate", "limit_mv"),
    [
        (Bench(), 0.1, 0.1),
        (Bench(), 0.3, 0.1),
        (Bench(), 1.0, 0.1),
        (SHAKING, 0.3, 0.5),
        (SHAKING, 0.5, 0.5),
        (SHAKING, 1.0, 0.5),
    ],
)
def test_a_trickle_does_not_pull_the_zero(bench: Bench, rate: float, limit_mv: float) -> None:
    found = zeros(replace(bench, flow=after(15.0, rate)), 150)
    assert found[-1] == pytest.approx(found[13], abs=limit_mv)


def test_a_trickle_too_small_to_see_pulls_it_by_no_more_than_its_own_force() -> None:
    found = zeros(replace(SHAKING, flow=after(15.0, 0.1)), 150)
    assert np.nanmax(found) <= 150.0 + 0.1 * 4.0 / 0.4448 + 0.4


def turns(time_s: float) -> float:
    """12 kg/s for 32 s, then 12 s without crop, in which the last grain comes within seconds."""
    into_s = (time_s - 1010.0) % 44.0
    if time_s < 1010.0:
        return 0.0
    return 12.0 * (1.0 - np.exp(-into_s / 0.7)) if into_s < 32.0 else 12.0 * np.exp(-(into_s - 32.0) / 0.7)


@pytest.mark.parametrize("bench", [Bench(), SHAKING], ids=["quiet", "shaking"])
def test_the_last_grain_before_each_turn_does_not_pull_the_zero(bench: Bench) -> None:
    found = zeros(replace(bench, flow=turns), 1200)
    assert found[15:] == pytest.approx(150.0, abs=0.4)
    assert found[600:].mean() == pytest.approx(150.0, abs=0.2)


def test_no_zero_is_learnt_while_cutting() -> None:
    header = [Frame(1000.0 + 0.5 * i, bus.HARVEST_STATE, {"HeaderDown": 1, "WorkState": 1}) for i in range(60)]
    target = monitor()
    feed(target, sorted([*Bench(flow=lambda t: 0.5).frames(30), *header], key=lambda f: f.time_s))
    assert len(target.records) >= 29
    assert np.isnan([r.zero_mv for r in target.records]).all()


def test_no_zero_is_learnt_from_a_full_flow() -> None:
    target = monitor()
    out = feed(target, Bench(flow=lambda t: 8.0).run(20))
    states = {f.signals["OperatingState"] for f in only(out, bus.YIELD_MONITOR_STATUS)}
    assert states == {OperatingState.ZEROING}
    assert {r.quality for r in target.records} == {EstimateQuality.NOT_AVAILABLE}


def test_far_drift_raises_the_fault() -> None:
    target = monitor()
    target.feed_run(Bench(zero=lambda t: 150.0 + 0.15 * (t - 1000.0)).run(320))
    assert FaultCode.ZERO_DRIFTED in target.faults.active
    assert target.records[-1].quality is not EstimateQuality.OK


def test_a_level_that_jumps_without_pulses_is_no_grain_and_raises_the_fault() -> None:
    target = monitor()
    feed(target, Bench(zero=lambda t: 150.0 if t < 1030 else 175.0).run(60))
    assert FaultCode.ZERO_DRIFTED in target.faults.active
    assert target.records[-1].quality is EstimateQuality.NOT_HARVESTING


def test_operators_zero_calibration_learns_any_vibration() -> None:
    bench = replace(SHAKING, paddle_vibration_mv=40.0)
    target = monitor()
    frames = bench.frames(40)
    feed(target, run_of([f for f in frames if f.time_s < 1010.5]))
    assert np.isnan(target.records[-1].zero_mv)
    target.calibrate_zero()
    feed(target, run_of([f for f in frames if f.time_s >= 1010.5]))
    assert target.records[-1].zero_mv == pytest.approx(150.0, abs=0.5)
    assert target.records[-1].operating_state is OperatingState.NOT_HARVESTING


def test_the_zero_moves_no_faster_than_its_rate() -> None:
    bench = Bench(zero=lambda t: 150.0 if t < 1030.0 else 160.0)
    found = zeros(bench, 60)
    steps = np.abs(np.diff(found[3:]))
    assert steps.max() == pytest.approx(0.2, rel=0.02)
