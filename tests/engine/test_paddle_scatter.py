"""The scatter of the paddles' momentum is learnt from the windows, and followed."""

from __future__ import annotations

import numpy as np
import pytest
from engine_bench import MACHINE, Bench, feed, monitor
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.sampling.paddle_scatter import PaddleScatter
from yieldmon.engine.settings import WindowSettings
from yieldmon.physics.machine import RPM

SETTINGS = WindowSettings()


@pytest.mark.parametrize("scatter", [0.03, 0.07, 0.12, 0.2])
def test_goes_from_the_prior_to_what_is_seen(scatter: float) -> None:
    rng = np.random.default_rng(3)
    learnt = PaddleScatter(SETTINGS)
    assert learnt.square == pytest.approx(SETTINGS.paddle_scatter**2)
    for _ in range(200):
        learnt.see(scatter**2 * rng.chisquare(5) / 5.0, 5.0)
    assert learnt.square**0.5 == pytest.approx(scatter, rel=0.12)


def test_without_a_prior_it_is_the_expected_one_until_something_is_seen() -> None:
    learnt = PaddleScatter(WindowSettings(scatter_prior_patterns=0.0))
    assert learnt.square == SETTINGS.paddle_scatter**2
    learnt.see(0.01, 5.0)
    assert learnt.square == pytest.approx(0.01)


def test_follows_another_crop() -> None:
    learnt = PaddleScatter(SETTINGS)
    for scatter in (0.05, 0.12):
        for _ in range(300):
            learnt.see(scatter**2, 5.0)
        assert learnt.square**0.5 == pytest.approx(scatter, rel=0.05)


@given(st.lists(st.tuples(st.floats(0.0, 1e6), st.floats(0.0, 12.0)), max_size=50))
def test_one_window_moves_it_little(seen: list[tuple[float, float]]) -> None:
    learnt = PaddleScatter(SETTINGS)
    for square, patterns in seen:
        before = learnt.square
        learnt.see(square, patterns)
        assert 0.0 <= learnt.square <= 4.0 * before * (1.0 + 1e-12)
        assert learnt.patterns <= SETTINGS.scatter_memory_patterns * (1.0 + 1e-12)


@pytest.mark.parametrize("scatter", [0.03, 0.12])
def test_force_is_as_precise_as_the_paddles_are_alike(scatter: float) -> None:
    target = monitor()
    feed(target, Bench(flow=lambda t: 12.0 if t >= 1005.0 else 0.0, noise_mv=0.5, scatter=scatter).run(90))
    records = target.records[40:]  # type: ignore[attr-defined]
    paddles = MACHINE.paddle_speed_m_s(400.0 * RPM) / MACHINE.paddle_spacing_m
    stated = np.median([r.force_std_dev_n / r.force_n for r in records])
    assert stated == pytest.approx(scatter / paddles**0.5, rel=0.2)
    seen = np.std([r.force_n for r in records]) / np.mean([r.force_n for r in records])
    assert 0.6 < seen / stated < 1.7
