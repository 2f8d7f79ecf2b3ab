"""The flow filter: quieter while steady, quick when not, honest about its spread."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.flow_filter import FlowFilter, FlowFilterSettings

SEED = 20261121
NOISE = 0.03


def run(true, seed=SEED, **settings):
    rng = np.random.default_rng(seed)
    seen = true * (1.0 + NOISE * rng.standard_normal(len(true)))
    flow_filter = FlowFilter(FlowFilterSettings(**settings))
    out = np.array([flow_filter.update(float(m), NOISE * float(m)) for m in seen])
    return seen, out[:, 0], out[:, 1]


def test_a_steady_flow_is_measured_better_than_by_single_windows():
    true = np.full(2000, 12.0)
    seen, flow, spread = run(true)
    assert np.std(flow[20:] - 12.0) < 0.62 * np.std(seen[20:] - 12.0)
    # The stated spread covers what was seen, without being several times too wide.
    assert 0.8 < np.sqrt(np.mean((flow[20:] - 12.0) ** 2)) / np.mean(spread[20:]) * 1.3 < 1.7


def test_a_ramp_is_followed_without_lag():
    true = np.concatenate((np.full(20, 6.0), np.linspace(6.0, 24.0, 45), np.full(20, 24.0)))
    errors = np.mean([run(true, seed=SEED + i)[1] / true - 1.0 for i in range(60)], axis=0)
    assert np.max(np.abs(errors[26:64])) < 0.015


def test_a_step_is_followed_at_once():
    true = np.concatenate((np.full(30, 6.0), np.full(30, 14.0)))
    after = np.array([run(true, seed=SEED + i)[1][30] for i in range(60)])
    assert np.mean(np.abs(after / 14.0 - 1.0)) < 0.05


def test_a_long_fall_and_what_follows_a_jump_are_averaged_over_seconds():
    """Of a noise of 3 % a fall of 40 s leaves 1.84 % and the third second after a jump 2.4 %."""
    fall = np.concatenate((np.full(30, 24.0), np.linspace(24.0, 10.0, 40)))
    falling = np.array([run(fall, seed=SEED + i)[1] / fall - 1.0 for i in range(100)])[:, 45:]
    assert np.sqrt(np.mean(falling**2)) < 0.0195
    jump = np.concatenate((np.full(30, 6.0), np.full(10, 14.0)))
    after = np.array([run(jump, seed=SEED + i)[1][32:34] / 14.0 - 1.0 for i in range(100)])
    assert np.sqrt(np.mean(after**2)) < 0.0255


def test_the_lead_carries_a_trend_forward():
    flow_filter = FlowFilter(FlowFilterSettings())
    for i in range(40):
        plain, _ = flow_filter.update(5.0 * 1.03**i, 0.01)
    again = FlowFilter(FlowFilterSettings())
    for i in range(40):
        led, _ = again.update(5.0 * 1.03**i, 0.01, 0.1)
    assert math.log(led / plain) == pytest.approx(0.1 * math.log(1.03), rel=0.1)


@pytest.mark.parametrize("flow", [math.nan, 0.0, -1.0, 0.1])
def test_what_it_cannot_use_comes_back_and_resets(flow):
    flow_filter = FlowFilter(FlowFilterSettings())
    flow_filter.update(10.0, 0.3)
    back = flow_filter.update(flow, 0.3)
    np.testing.assert_equal(back, (flow, 0.3))
    assert flow_filter.update(20.0, 0.3) == (20.0, 0.3)


def test_switched_off_it_changes_nothing():
    seen, flow, _ = run(np.full(50, 9.0), enabled=False)
    np.testing.assert_array_equal(seen, flow)


@pytest.mark.parametrize("lead_windows", [-1.0, 1.0, 3.0])
def test_the_spread_of_a_flow_led_away_grows_to_both_sides(lead_windows):
    """Level and trend are known together: where the trend carries the flow back to windows seen, it is no surer than here."""
    spreads = {0.0: [], lead_windows: []}
    for lead, spread in spreads.items():
        flow_filter = FlowFilter(FlowFilterSettings())
        for seen in 12.0 * (1.0 + NOISE * np.random.default_rng(SEED).standard_normal(100)):
            spread.append(flow_filter.update(seen, NOISE * seen, lead)[1])
    assert np.mean(spreads[lead_windows][20:]) > 1.3 * np.mean(spreads[0.0][20:])


@given(
    st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=60),
    st.floats(min_value=0.0, max_value=1e6),
    st.floats(min_value=-2.0, max_value=2.0),
)
def test_nothing_makes_it_raise_or_diverge(flows, spread, lead_windows):
    flow_filter = FlowFilter(FlowFilterSettings())
    for flow in flows:
        out, sd = flow_filter.update(flow, spread, lead_windows)
        if math.isfinite(flow) and flow >= 0.3 and spread > 0.0:
            assert out > 0.0
            assert not math.isnan(sd)
