"""Samples of ``python -m tests.robustness simulation`` and ``bus-simulation``: no invariant broken, a mend undone is found."""

from __future__ import annotations

import pytest

from tests.robustness import bus_simulation
from tests.robustness import simulation as store_simulation
from tests.robustness.undoing import found_without, quiet


@pytest.fixture(autouse=True)
def silent():
    with quiet():
        yield


def test_simulated_days_break_no_invariant():
    world = store_simulation.simulate(40, seed=7)
    assert world.broken == []
    assert len(world.troubles) >= 8


@pytest.mark.parametrize("mend", ["rescue", "removed files", "witness of commits", "interrupted replacement"])
def test_a_mend_undone_is_found(mend):
    assert found_without(store_simulation.MENDS[mend], 60, 7).found


def test_simulated_harvests_on_a_bus_break_no_invariant():
    broken, met = bus_simulation.simulate(9, seed=7)
    assert broken == []
    assert len(met) == 7


@pytest.mark.parametrize(
    "mend", ["waiting on monotonic time", "each echo once", "signs of life of the transmitter", "contested mass apart"]
)
def test_a_mend_undone_on_a_bus_is_found(mend):
    assert found_without(bus_simulation.MENDS[mend], 2, 7).found
