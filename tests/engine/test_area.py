"""Area: width times way, delayed to the grain at the plate, by load, known or not; market moisture by crop."""

from __future__ import annotations

from dataclasses import replace
from math import isnan, nan

import pytest

from yieldmon.engine.area import AreaCounter
from yieldmon.engine.inputs import Inputs
from yieldmon.engine.settings import EngineSettings, GateSettings, InputSettings, TotalsSettings
from yieldmon.engine.totals import Totals, dry_mass
from yieldmon.physics.machine import Implement

WIDTH_M, SPEED_M_S = 9.0, 2.0


def drive(implement: Implement, reported: list[dict[str, float]], grain: list[bool]) -> list[float]:
    """Areas of seconds with these inputs at their ends."""
    counter, inputs = AreaCounter(implement, GateSettings()), Inputs(InputSettings())
    found = []
    for second, (values, comes) in enumerate(zip(reported, grain, strict=True), 1):
        for name in ("ground_speed", "header_down", "work_state"):
            inputs.held[name].set(float(second), values.get(name, nan))
        found.append(counter.second(float(second), 1.0, inputs.snapshot(float(second)), grain_comes=comes))
    return found


def test_area_is_that_of_the_grain_at_the_plate() -> None:
    cutting = {"ground_speed": SPEED_M_S, "header_down": 1.0}
    reported = [cutting] * 20 + [{"ground_speed": SPEED_M_S, "header_down": 0.0}] * 20
    areas = drive(Implement(working_width_m=WIDTH_M, grain_delay_s=12.0), reported, [False] * 12 + [True] * 20 + [False] * 8)
    assert all(isnan(area) for area in areas[:12])
    assert areas[12:32] == [WIDTH_M * SPEED_M_S] * 20
    assert areas[32:] == [0.0] * 8


@pytest.mark.parametrize(
    ("inputs", "grain", "expected"),
    [
        ({"ground_speed": SPEED_M_S}, True, WIDTH_M * SPEED_M_S),
        ({"ground_speed": SPEED_M_S}, False, 0.0),
        ({"ground_speed": SPEED_M_S, "header_down": 1.0}, False, WIDTH_M * SPEED_M_S),
        ({"ground_speed": SPEED_M_S, "work_state": 0.0}, True, 0.0),
        ({"ground_speed": 0.1}, True, 0.0),
        ({}, True, nan),
    ],
    ids=["grain says", "no grain", "header says", "drives off", "standing", "no speed"],
)
def test_when_ground_counts(inputs: dict[str, float], grain: bool, expected: float) -> None:
    (area,) = drive(Implement(working_width_m=WIDTH_M), [inputs], [grain])
    assert area == pytest.approx(expected, nan_ok=True)


def test_without_a_width_no_area_is_known() -> None:
    assert isnan(drive(Implement(), [{"ground_speed": 0.0}], [False])[0])


def test_totals_keep_area_by_load_and_the_mass_without_one() -> None:
    totals = Totals().with_area(18.0, 10.0).with_area(nan, 4.0)
    assert (totals.load_area_m2, totals.load_unknown_area_kg) == (18.0, 4.0)
    assert totals.stop_load().with_area(18.0, 1.0).load_area_m2 == 18.0
    fresh = totals.start_load()
    assert (fresh.load_area_m2, fresh.load_unknown_area_kg) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("given", "market", "expected"), [(None, 13.5, 100.0 * 80.0 / 86.5), (15.5, 13.5, 100.0 * 80.0 / 84.5)], ids=["crop", "set"]
)
def test_dry_mass_is_at_the_crops_market_moisture_unless_the_configuration_says(
    given: float | None, market: float, expected: float
) -> None:
    settings = TotalsSettings(moisture_reference_pct=given)
    assert dry_mass(100.0, 20.0, settings, market) == pytest.approx(expected)
    engine = replace(EngineSettings(), totals=settings)
    assert engine.totals.moisture_reference_pct == given
