"""Samples of ``python -m tests.robustness simulation`` and ``bus-simulation``: no invariant broken, a mend undone is found."""

from __future__ import annotations

import logging

import pytest

from tests.robustness import bus_simulation
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


def test_simulated_harvests_on_a_bus_break_no_invariant():
    broken, met = bus_simulation.simulate(8, seed=7)
    assert broken == []
    assert len(met) == 6


@pytest.mark.parametrize(
    "mend", ["waiting on monotonic time", "each echo once", "signs of life of the transmitter", "contested mass apart"]
)
def test_a_mend_undone_on_a_bus_is_found(mend):
    trouble, undo = bus_simulation.UNDO[mend]
    with undo():
        assert bus_simulation.simulate(2, 7, (trouble,))[0]
