"""When the tank counts as emptied, second by second: limits of switch and scale, met exactly and missed by a little."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest

from yieldmon.engine.inputs import InputSnapshot
from yieldmon.engine.mass.unloading import Unloading
from yieldmon.engine.settings import EngineSettings, TotalsSettings

PLAY_KG = EngineSettings().reference_masses.unloading_kg
ON, OFF, SILENT = 1.0, 0.0, nan
LEAST_S = 10.0


def follow(new_load: str) -> Unloading:
    return Unloading(replace(EngineSettings(), totals=TotalsSettings(new_load=new_load, unloading_s=LEAST_S)))


def snapshot(*, unloading: float = nan, tank_kg: float = nan, disputed: bool = False) -> InputSnapshot:
    return InputSnapshot(0.0, True, 0.0, 70.0, 0, nan, -inf, tank_kg, {"unloading": unloading}, disputed)


def emptied_at(*stretches: tuple[float, float], second_s: float = 1.0) -> list[float]:
    """Seconds after which the tank counts as emptied; a switch that says one thing for so long, then the next."""
    tank, now_s, found = follow("switch"), 0.0, []
    for value, duration_s in stretches:
        for _ in range(round(duration_s / second_s)):
            now_s += second_s
            if tank.emptied(snapshot(unloading=value), second_s):
                found.append(now_s)
    return found


@pytest.mark.parametrize("second_s", [1.0, 0.5])
@pytest.mark.parametrize(
    ("stretches", "expected"),
    [
        ([(ON, 10.0), (OFF, 30.0)], [20.0]),
        ([(ON, 9.0), (OFF, 30.0)], []),
        ([(ON, 5.0), (OFF, 9.0), (ON, 5.0), (OFF, 30.0)], [29.0]),
        ([(ON, 5.0), (OFF, 10.0), (ON, 5.0), (OFF, 30.0)], []),
        ([(ON, 12.0), (OFF, 9.0)], []),
        ([(ON, 12.0), (OFF, 6.0), (ON, 1.0), (OFF, 9.0)], []),
        ([(ON, 12.0), (OFF, 6.0), (ON, 1.0), (OFF, 10.0)], [29.0]),
        ([(ON, 12.0), (SILENT, 30.0)], []),
        ([(ON, 12.0), (SILENT, 30.0), (OFF, 10.0)], [52.0]),
        ([(ON, 12.0), (OFF, 4.0), (SILENT, 30.0), (OFF, 6.0)], [52.0]),
        ([(OFF, 30.0)], []),
        ([(ON, 10.0), (OFF, 10.0), (ON, 10.0), (OFF, 30.0)], [20.0, 40.0]),
        ([(ON, 10.0), (OFF, 10.0), (ON, 9.0), (OFF, 30.0)], [20.0]),
    ],
    ids=[
        "long enough", "too short", "two that are long enough together", "two too far apart", "not over yet", "on again",
        "on again and over", "silent since", "silent between", "silent while it is over", "never on", "twice",
        "nothing is left of the first",
    ],
)  # fmt: skip
def test_by_the_switch(stretches: list[tuple[float, float]], expected: list[float], second_s: float) -> None:
    assert emptied_at(*stretches, second_s=second_s) == expected


@pytest.mark.parametrize("new_load", ["tank_scale", "command"])
def test_the_switch_says_nothing_where_another_ends_a_load(new_load: str) -> None:
    tank = follow(new_load)
    assert not any(tank.emptied(snapshot(unloading=value), 1.0) for value in [ON] * 20 + [OFF] * 40)


def by_scale(*readings: tuple[float, int], disputed: tuple[int, ...] = ()) -> list[int]:
    """Seconds after which the tank counts as emptied; a scale that reads so many kg for so many seconds, then the next."""
    tank = follow("tank_scale")
    masses = [mass_kg for mass_kg, seconds in readings for _ in range(seconds)]
    return [second for second, kg in enumerate(masses, 1) if tank.emptied(snapshot(tank_kg=kg, disputed=second in disputed), 1.0)]


@pytest.mark.parametrize(
    ("readings", "expected"),
    [
        ([(4000.0, 5), (2000.0, 20)], [15]),
        ([(4000.0, 5), (2001.0, 20)], []),
        ([(4000.0, 5), (0.0, 9)], []),
        ([(4000.0, 5), (0.0, 5), (4000.0, 5), (0.0, 9)], [20]),
        ([(4000.0, 5), (1500.0, 5), (1000.0, 20)], [20]),
        ([(4000.0, 5), (1500.0, 5), (1500.0 - PLAY_KG, 20)], [15]),
        ([(4000.0, 5), (1500.0, 5), (1499.0 - PLAY_KG, 20)], [20]),
        ([(PLAY_KG, 5), (0.0, 20)], [15]),
        ([(PLAY_KG - 1.0, 5), (0.0, 20)], []),
        ([(4000.0, 5), (0.0, 40)], [15]),
        ([(4000.0, 5), (0.0, 20), (4000.0, 5), (0.0, 20)], [15, 40]),
        ([(4000.0, 5), (nan, 5), (0.0, 10)], [20]),
        ([(nan, 30)], []),
    ],
    ids=[
        "half is gone", "hardly half", "for too short", "what was gone before counts on", "still falling", "within the play",
        "just beyond it", "as little as counts", "less than counts", "once only", "twice", "no reading between", "no scale",
    ],
)  # fmt: skip
def test_by_the_scale(readings: list[tuple[float, int]], expected: list[int]) -> None:
    assert by_scale(*readings) == expected


def test_readings_of_two_scales_empty_nothing() -> None:
    readings = ((4000.0, 5), (0.0, 20))
    assert by_scale(*readings, disputed=tuple(range(1, 26))) == []
    assert by_scale(*readings, disputed=(10,)) == [], "what was held before is forgotten"
    assert by_scale(*readings, disputed=(3,)) == [15]
