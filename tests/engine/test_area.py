"""Area: width times way, delayed to the grain at the plate, by load, known or not; market moisture by crop."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import isnan, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.inputs import Inputs
from yieldmon.engine.mass.area import AreaCounter
from yieldmon.engine.mass.totals import Totals, dry_mass
from yieldmon.engine.settings import EngineSettings, GateSettings, InputSettings, TotalsSettings
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


@pytest.mark.parametrize("says_up", [{"header_down": 0.0}, {"work_state": 0.0}], ids=["header", "work state"])
@pytest.mark.parametrize("delay_s", [0.0, 12.0])
def test_no_area_is_known_once_grain_comes_long_after_the_header_went_up(delay_s: float, says_up: dict[str, float]) -> None:
    """With its signal inverted the headland was the area of the passes."""
    emptied_s = int(delay_s + GateSettings().emptying_s)
    down = dict.fromkeys(says_up, 1.0)
    # A pass of 200 s, a headland of 40 s, in which the last grain comes for 15 s, and a pass; then the signal is put right.
    reported = [
        {"ground_speed": SPEED_M_S, **(down if 200 <= second < 240 or second >= 440 else says_up)} for second in range(640)
    ]
    areas = drive(Implement(working_width_m=WIDTH_M, grain_delay_s=delay_s), reported, [not 215 <= n < 240 for n in range(640)])
    known_s = 440 + emptied_s + 1
    assert [n for n, area in enumerate(areas) if not isnan(area)] == [*range(int(delay_s), emptied_s + 1), *range(known_s, 640)]
    assert areas[known_s:] == [WIDTH_M * SPEED_M_S] * (640 - known_s)
    # A machine that runs empty and drives on cuts nothing.
    up = [{"ground_speed": SPEED_M_S, **says_up}] * 200
    areas = drive(Implement(working_width_m=WIDTH_M, grain_delay_s=delay_s), up, [n < 20 for n in range(200)])
    assert areas[int(delay_s) :] == [0.0] * (200 - int(delay_s))


NO_WIDTH = "the machine file states no implement.working_width_m"
CONTRADICTED = "grain comes although header or drives are reported not to cut"
START = "grain comes 12 s after it is cut, and what came before the start is not known"
CUTTING = {"ground_speed": SPEED_M_S, "header_down": 1.0}


@pytest.mark.parametrize(
    ("implement", "reported", "expected"),
    [
        (Implement(), [CUTTING], [NO_WIDTH]),
        (Implement(), [{"ground_speed": 0.0}], [NO_WIDTH]),
        (Implement(working_width_m=WIDTH_M), [CUTTING, {}, CUTTING], ["", "no ground speed is received", ""]),
        (Implement(working_width_m=WIDTH_M, grain_delay_s=12.0), [CUTTING] * 13, [START] * 12 + [""]),
        (
            Implement(working_width_m=WIDTH_M),
            [{"ground_speed": SPEED_M_S, "header_down": 0.0}] * 200,
            [""] * int(GateSettings().emptying_s + 1) + [CONTRADICTED] * int(199 - GateSettings().emptying_s),
        ),
    ],
    ids=["no width", "no width, standing", "no speed", "start", "header inverted"],
)
def test_why_no_area_is_known(implement: Implement, reported: list[dict[str, float]], expected: list[str]) -> None:
    counter, inputs = AreaCounter(implement, GateSettings()), Inputs(InputSettings())
    for second, (values, why) in enumerate(zip(reported, expected, strict=True), 1):
        for name in ("ground_speed", "header_down"):
            inputs.held[name].set(float(second), values.get(name, nan))
        area_m2 = counter.second(float(second), 1.0, inputs.snapshot(float(second)), grain_comes=True)
        assert (second, counter.unknown_because, isnan(area_m2)) == (second, why, bool(why))


LEAST_M_S = GateSettings().min_ground_speed_m_s


def counted_m2(width_m: float | None, speed_m_s: float, header: float, work: float, grain: bool) -> float:
    """Area of a second, m2: what the header and the drives say goes before what the grain says."""
    if header == 0.0 or work == 0.0 or speed_m_s < LEAST_M_S:
        return nan if width_m is None else 0.0
    if width_m is None or isnan(speed_m_s):
        return nan
    return width_m * speed_m_s if grain or header == 1.0 or work == 1.0 else 0.0


def test_any_combination_of_what_the_bus_and_the_grain_say() -> None:
    for case in product(
        (None, WIDTH_M), (nan, 0.0, LEAST_M_S - 0.01, LEAST_M_S, 2.0), (nan, 0.0, 1.0), (nan, 0.0, 1.0), (False, True)
    ):
        width_m, speed, header, work, grain = case
        reported = {"ground_speed": speed, "header_down": header, "work_state": work}
        (area,) = drive(Implement(working_width_m=width_m), [reported], [grain])
        assert area == pytest.approx(counted_m2(*case), nan_ok=True), case


@given(
    st.lists(st.tuples(st.sampled_from([0.0, 1.0, 2.0, 5.0]), st.booleans()), min_size=1, max_size=20),
    st.sampled_from([0.0, 0.5, 1.0, 2.5, 3.0, 19.0]),
)
def test_area_is_that_of_the_second_the_delay_before(seconds: list[tuple[float, bool]], delay_s: float) -> None:
    """Of the last second that had ended by then."""
    reported = [{"ground_speed": speed, "work_state": 1.0} for speed, _ in seconds]
    found = drive(Implement(working_width_m=WIDTH_M, grain_delay_s=delay_s), reported, [grain for _, grain in seconds])
    for number, area in enumerate(found, 1):
        cut = int(number - delay_s // 1) - (1 if delay_s % 1 else 0)
        expected = nan if cut < 1 else counted_m2(WIDTH_M, seconds[cut - 1][0], nan, 1.0, grain=True)
        assert area == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("says_up", [{"header_down": 0.0}, {"work_state": 0.0}], ids=["header", "work state"])
@pytest.mark.parametrize(("moment_s", "speed_m_s", "cuts"), [(1, 2.0, True), (2, 2.0, True), (3, 2.0, False), (1, 0.0, False)])
def test_a_moment_with_the_header_up_within_a_pass_cuts_on(
    moment_s: int, speed_m_s: float, cuts: bool, says_up: dict[str, float]
) -> None:
    """speed_m_s: while it is up."""
    down = {"ground_speed": SPEED_M_S, **dict.fromkeys(says_up, 1.0)}
    up = {"ground_speed": speed_m_s, **says_up}
    reported = [down] * 20 + [up] * moment_s + [down] * 40
    areas = drive(Implement(working_width_m=WIDTH_M, grain_delay_s=12.0), reported, [True] * len(reported))
    whole = WIDTH_M * SPEED_M_S
    assert areas[12:32] == [whole] * 20
    assert areas[32 : 32 + moment_s] == [whole if cuts else 0.0] * moment_s
    assert areas[32 + moment_s :] == [whole] * (len(reported) - 32 - moment_s)


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
