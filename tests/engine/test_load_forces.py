"""Forces over a load in few numbers: nothing of it is lost, and what is not known is said."""

from __future__ import annotations

import math

import pytest

from yieldmon.engine.self_calibration.load_forces import LoadForceSums, WindowForces

WINDOW = {"seconds": 1.0, "force_n": 40.0, "angle_rad": 1.2, "speed_rad_s": 42.0, "moisture_pct": 15.0}


def sums(*windows: dict[str, float], load: int = 1) -> LoadForceSums:
    found = LoadForceSums()
    for window in windows:
        values = {"mass_kg": 10.0, **WINDOW, **window}
        found.add(load, values.pop("mass_kg"), WindowForces(**values))
    return found


def test_like_windows_share_a_group_whose_means_are_theirs():
    forces = sums({}, {"force_n": 41.0, "seconds": 3.0, "moisture_pct": 17.0}).of(1)
    assert forces is not None
    assert forces.duration_s.tolist() == [4.0]
    assert forces.force_n.tolist() == pytest.approx([(40.0 + 3 * 41.0) / 4.0])
    assert forces.plate_angle_rad.tolist() == pytest.approx([1.2])
    assert forces.elevator_speed_rad_s.tolist() == pytest.approx([42.0])
    assert forces.moisture_pct.tolist() == pytest.approx([(15.0 + 3 * 17.0) / 4.0])


@pytest.mark.parametrize("change", [{"force_n": 60.0}, {"angle_rad": 1.0}, {"speed_rad_s": 50.0}])
def test_others_have_one_of_their_own(change):
    forces = sums({}, change).of(1)
    assert forces is not None
    assert forces.duration_s.tolist() == [1.0, 1.0]


@pytest.mark.parametrize(("unknown", "known"), [(1, 20), (2, 20)])
@pytest.mark.parametrize("change", [{"force_n": math.nan}, {"force_n": 0.0}, {"angle_rad": math.nan}, {"speed_rad_s": 0.0}])
def test_a_few_windows_without_a_force_count_like_the_others(unknown, known, change):
    forces = sums(*[{}] * known, *[change] * unknown).of(1)
    assert forces is not None
    assert forces.duration_s.sum() == pytest.approx(known + unknown)


def test_a_load_of_which_more_is_not_known_has_none():
    assert sums(*[{}] * 20, *[{"force_n": math.nan}] * 3).of(1) is None
    assert sums({"force_n": math.nan}).of(1) is None
    assert sums({}).of(2) is None
    assert sums({"mass_kg": 0.0}).of(1) is None


@pytest.mark.parametrize(("unknown", "expected"), [(1, 15.0), (2, math.nan)])
def test_moisture_of_a_group_most_of_which_lacks_it_is_not_known(unknown, expected):
    forces = sums({}, *[{"moisture_pct": math.nan}] * unknown, *[{}] * (2 - unknown)).of(1)
    assert forces is not None
    assert forces.moisture_pct.tolist() == pytest.approx([expected], nan_ok=True)


def test_the_newest_loads_are_kept():
    found = LoadForceSums()
    for load in range(70):
        found.add(load, 10.0, WindowForces(**WINDOW))
    assert [load for load in range(70) if found.of(load) is None] == list(range(6))
    found.forget()
    assert found.of(69) is None


@pytest.mark.parametrize(("after", "known"), [(0, False), (1, False), (5, False), (30, True)])
def test_a_load_most_of_which_was_forgotten_has_none(after, known):
    """The rest alone would be held against the mass of the whole load."""
    found = sums({}, {})
    found.forget()
    for _ in range(after):
        found.add(1, 10.0, WindowForces(**WINDOW))
    forces = found.of(1)
    assert (forces is not None) is known
    assert forces is None or forces.duration_s.sum() == pytest.approx(after + 2)
