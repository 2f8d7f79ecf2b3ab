"""A sample of ``python -m tests.robustness simulation``: no invariant broken, and a mend undone is found."""

from __future__ import annotations

import logging

import pytest

from tests.robustness.simulation import simulate, undone


@pytest.fixture(autouse=True)
def quiet():
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def test_simulated_days_break_no_invariant():
    world = simulate(40, seed=7)
    assert world.broken == []
    assert len(world.troubles) >= 8


@pytest.mark.parametrize("mend", ["rescue", "removed files", "witness of commits", "interrupted replacement"])
def test_a_mend_undone_is_found(mend):
    with undone(mend):
        assert simulate(60, seed=7).broken
