"""Which seconds come between a load's end and the next one's begin, also where the clock was set."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.service.test_remeasuring import rows
from yieldmon.service.storage.batch import Load
from yieldmon.service.storage.load_ends import between_loads, load_of
from yieldmon.service.storage.rows import SecondRow

HOUR_S = 3600.0
#: Seconds 1 to 5 of a load that begins at 99 s, then 6 to 8 after its end.
IN_LOAD, AFTER = range(1, 6), range(6, 9)


def recorded(set_before: int, step_s: float, *, without_mass: tuple[int, ...] = ()) -> tuple[list[SecondRow], Load]:
    """Five seconds of a load and three after it; the clock is set by step_s before a second."""
    template, load_kg, found = rows(4, 100.0)[0], 0.0, []
    for number in (*IN_LOAD, *AFTER):
        mass_kg = 0.0 if number in without_mass else 10.0
        load_kg += mass_kg if number in IN_LOAD else 0.0
        time_s = 99.0 + number + (step_s if number >= set_before else 0.0)
        found.append(replace(template, number=number, time_s=time_s, mass_kg=mass_kg, load_kg=load_kg))
    return found, Load(4, "", "", 99.0, found[4].time_s, 50.0, None)


@pytest.mark.parametrize("step_s", [0.0, -2 * HOUR_S, 2 * HOUR_S])
@pytest.mark.parametrize("set_before", [2, 5, 6, 7])
def test_grain_after_the_end_is_of_no_load_whenever_the_clock_is_set(set_before: int, step_s: float) -> None:
    seconds, load = recorded(set_before, step_s)
    between = between_loads(seconds, [load])
    assert sorted(between) == [*AFTER]
    assert [load_of(second, between) for second in seconds] == [4] * 5 + [None] * 3


def test_the_seconds_of_one_load_alone_may_begin_after_its_end_by_the_clock() -> None:
    seconds, load = recorded(2, -2 * HOUR_S)
    assert between_loads(seconds[:5], [load]) == frozenset()


def test_seconds_without_mass_are_told_by_time() -> None:
    seconds, load = recorded(9, 0.0, without_mass=(1, 3, 7))
    assert sorted(between_loads(seconds, [load])) == [*AFTER]


def test_a_load_without_an_end_goes_on() -> None:
    seconds, load = recorded(9, 0.0)
    assert between_loads(seconds, [replace(load, ended_s=None)]) == frozenset()
    assert between_loads(seconds, []) == frozenset()


def test_a_second_after_missing_ones_is_told_by_time() -> None:
    seconds, load = recorded(9, 0.0)
    assert sorted(between_loads([*seconds[:3], *seconds[6:]], [load])) == [7, 8]


def test_a_correction_of_the_load_does_not_move_its_end() -> None:
    """Mass that a wrong zero had missed joins the last load, also once it has ended."""
    seconds, load = recorded(9, 0.0)
    corrected = [replace(second, load_kg=second.load_kg + (7.0 if second.number >= 7 else 0.0)) for second in seconds]
    assert sorted(between_loads(corrected, [load])) == [*AFTER]
