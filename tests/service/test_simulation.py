"""Samples of the simulations of ``python -m tests.robustness``: no invariant broken, a mend undone is found."""

from __future__ import annotations

import pytest

from tests.robustness import bus_simulation, files_simulation, process_simulation
from tests.robustness import simulation as store_simulation
from tests.robustness.mends import POINTS, SHARES
from tests.robustness.undoing import found_without, quiet


@pytest.fixture(autouse=True)
def silent():
    with quiet():
        yield


MENDS = [(share.name, name, mend) for share in SHARES for name, mend in share.simulation.mends.items()]


@pytest.mark.parametrize("mend", [mend for *_, mend in MENDS], ids=[f"{share}: {name}" for share, name, _ in MENDS])
def test_what_a_mend_replaces_is_there(mend):
    with mend.undone():
        pass


def test_simulated_days_break_no_invariant():
    world = store_simulation.simulate(40, seed=7)
    assert world.broken == []
    assert len(world.troubles) >= 8


@pytest.mark.parametrize("mend", ["rescue", "removed files", "witness of commits", "stores read from a copy"])
def test_a_correction_taken_out_is_found(mend):
    assert found_without(store_simulation.MENDS[mend], 20, 7).found


def test_simulated_harvests_on_a_bus_break_no_invariant():
    broken, met = bus_simulation.simulate(9, seed=7)
    assert broken == []
    assert len(met) == 7


@pytest.mark.parametrize(
    "mend", ["waiting on monotonic time", "each echo once", "signs of life of the transmitter", "contested mass apart"]
)
def test_a_correction_taken_out_on_a_bus_is_found(mend):
    assert found_without(bus_simulation.MENDS[mend], 2, 7).found


@pytest.mark.parametrize(("simulation", "lives", "troubles"), [(process_simulation, 5, 5), (files_simulation, 12, 12)])
def test_simulated_lives_of_process_and_files_break_no_invariant(simulation, lives, troubles):
    broken, met = simulation.simulate(lives, seed=7)
    assert broken == []
    assert len(met) == troubles


@pytest.mark.parametrize(
    ("simulation", "mend"),
    [
        (process_simulation, "flags for signals"), (process_simulation, "answers that are cut"),
        (files_simulation, "modes of what is saved"), (files_simulation, "names of parents"),
    ],
)  # fmt: skip
def test_a_correction_taken_out_in_process_and_files_is_found(simulation, mend):
    assert found_without(simulation.MENDS[mend], 2, 7).found


def test_each_point_of_the_list_has_a_correction_that_can_be_taken_out():
    assert {number for share in SHARES for mend in share.simulation.mends.values() for number in mend.points} == set(POINTS)
