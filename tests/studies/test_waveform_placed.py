"""Discrete-element pulses on uneven chains, and grain that strikes the plate again, as the studies make them."""

from __future__ import annotations

import numpy as np
import pytest

from studies.waveform import again, placed
from studies.waveform.kernels import FORCES, MORE_FORCES, heaps
from studies.waveform.placed_pulses import EMPTY_S, PADDLES, Chain, strikes

SPACING_M, SPEED_M_S = 0.186, 2.27


def _late_mm(chain: Chain) -> np.ndarray:
    when, _ = strikes(chain, spacing_m=SPACING_M, speed_m_s=SPEED_M_S, end_s=60.0, rng=np.random.default_rng(3))
    return np.asarray(1e3 * SPEED_M_S * (when - EMPTY_S - np.arange(when.size) * SPACING_M / SPEED_M_S))


def test_chains_put_pulses_where_their_geometry_says() -> None:
    assert np.ptp(_late_mm(Chain())) < 1e-6
    # Of eight teeth of 41.4 mm: radius times sin less the chord's mean, at most.
    assert 0.1 < np.abs(_late_mm(Chain(polygon=True))).max() < 0.22
    assert _late_mm(Chain(ripple=0.02)).max() == pytest.approx(20.0 * SPEED_M_S / (2.0 * np.pi * 6.7), rel=0.02)
    assert np.unique(_late_mm(Chain(late_mm=20.0, late_paddles=1)).round(6)).tolist() == [0.0, 20.0]
    _, size = strikes(Chain(missing=4), spacing_m=SPACING_M, speed_m_s=SPEED_M_S, end_s=60.0, rng=np.random.default_rng(3))
    assert (size == 0.0).mean() == pytest.approx(4.0 / PADDLES, abs=0.01)


def test_the_daemon_takes_an_even_chain_and_refuses_one_that_jerks() -> None:
    judge = placed.Judge(heaps(FORCES, MORE_FORCES), placed.GROUPS["0.5 kg"], 0.0002, 5501)
    even, jerks = judge.row(Chain(), 5505), judge.row(Chain(ripple=0.05), 5505)
    assert even["refused_pct"] == 0
    assert abs(even["error_pct"]) < 2.0 * even["stated_pct"]
    assert jerks["refused_pct"] == 100


@pytest.mark.parametrize("seed", [6002, 6004, 6006])
def test_thin_loads_on_an_even_chain_are_taken(seed: int) -> None:
    """The fit's own time errs by milliseconds there; pulses laid on one another by it left up to 2.6 times the kernels' noise."""
    judge = placed.Judge(heaps(FORCES, MORE_FORCES), placed.GROUPS["0.2 kg"], 0.0002, 0, bias=1.0)
    found = judge.row(Chain(), seed)
    assert found["refused_pct"] == 0
    assert found["stated_pct"] < 12.0
    assert abs(found["error_pct"]) < 8.0


def test_a_second_strike_shows_in_the_noise_only_where_all_delays_are_alike() -> None:
    alike, unlike = (again.shown(again.kernels_again(True, scatter, 5), 5) for scatter in (0.0, 0.1))
    assert alike["at_the_delay"] > 0.2
    assert abs(unlike["at_the_delay"]) < 0.03
    assert unlike["flow"] == pytest.approx(alike["flow"], rel=0.02)
