"""Sums of mass, each in its place."""

from __future__ import annotations

from dataclasses import fields, replace
from math import isnan

import pytest

from yieldmon.engine.mass.budget import EMPTY, FlowBudget, MassBudget
from yieldmon.engine.mass.missed_mass import MissedMass
from yieldmon.engine.mass.totals import Totals, dry_mass
from yieldmon.engine.settings import TotalsSettings

BEGUN = Totals(
    total_kg=1000.0, total_dry_kg=600.0, total_unknown_moisture_kg=300.0, load_kg=100.0, load_dry_kg=60.0,
    load_unknown_moisture_kg=30.0, load_number=4, total_contested_kg=70.0, load_contested_kg=7.0, load_area_m2=11.0,
    load_unknown_area_kg=5.0, market_moisture_pct=14.0,
)  # fmt: skip


def changes(before: Totals, after: Totals) -> dict[str, float]:
    names = (item.name for item in fields(Totals) if item.name.endswith(("_kg", "_m2")))
    found = {name: getattr(after, name) - getattr(before, name) for name in names}
    return {name: change for name, change in found.items() if change}


@pytest.mark.parametrize(
    ("dry_kg", "is_open", "expected"),
    [
        (9.0, True, {"total_kg": 10.0, "total_dry_kg": 9.0, "load_kg": 10.0, "load_dry_kg": 9.0}),
        (9.0, False, {"total_kg": 10.0, "total_dry_kg": 9.0}),
        (None, True, {"total_kg": 10.0, "total_unknown_moisture_kg": 10.0, "load_kg": 10.0, "load_unknown_moisture_kg": 10.0}),
        (None, False, {"total_kg": 10.0, "total_unknown_moisture_kg": 10.0}),
    ],
)
def test_mass_joins_what_it_belongs_to_and_nothing_else(dry_kg, is_open, expected):
    before = BEGUN if is_open else BEGUN.stop_load()
    after = before.with_mass(10.0, dry_kg)
    assert changes(before, after) == pytest.approx(expected)
    assert (after.load_number, after.load_open, after.market_moisture_pct) == (4, is_open, 14.0)


@pytest.mark.parametrize(
    ("is_open", "expected"),
    [(True, {"total_contested_kg": 10.0, "load_contested_kg": 10.0}), (False, {"total_contested_kg": 10.0})],
)
def test_contested_mass_is_in_no_other_sum(is_open, expected):
    before = BEGUN if is_open else BEGUN.stop_load()
    assert changes(before, before.with_contested(10.0)) == pytest.approx(expected)


@pytest.mark.parametrize("mass_kg", [-0.1, float("nan"), float("inf")])
def test_no_mass_that_is_none(mass_kg):
    with pytest.raises(ValueError, match="at least 0"):
        BEGUN.with_mass(mass_kg, None)


@pytest.mark.parametrize(
    ("moisture_pct", "settings", "expected"),
    [
        (20.0, TotalsSettings(), 100.0 * 80.0 / 86.0),
        (10.0, TotalsSettings(), 100.0),
        (10.0, TotalsSettings(credit_below_reference=True), 100.0 * 90.0 / 86.0),
        (20.0, TotalsSettings(moisture_reference_pct=10.0), 100.0 * 80.0 / 90.0),
        (float("nan"), TotalsSettings(), None),
    ],
)
def test_dry_mass_at_market_moisture(moisture_pct, settings, expected):
    found = dry_mass(100.0, moisture_pct, settings, 14.0)
    assert found == (None if expected is None else pytest.approx(expected))


MORE = MissedMass(kg=8.0, dry_kg=5.0, unknown_moisture_kg=3.0, unknown_area_kg=2.0)
LESS = MissedMass(kg=-8.0, dry_kg=-5.0, unknown_moisture_kg=-3.0, unknown_area_kg=-2.0)
FAR_LESS = MissedMass(kg=-150.0, dry_kg=-90.0, unknown_moisture_kg=-45.0, unknown_area_kg=-9.0)
ALL_GONE = MissedMass(kg=-2000.0, dry_kg=-1200.0, unknown_moisture_kg=-600.0, unknown_area_kg=-9.0)
IN_TOTAL = ("total_kg", "total_dry_kg", "total_unknown_moisture_kg")
IN_LOAD = ("load_kg", "load_dry_kg", "load_unknown_moisture_kg", "load_unknown_area_kg")


@pytest.mark.parametrize("in_load", [True, False])
@pytest.mark.parametrize("missed", [MORE, LESS, FAR_LESS, ALL_GONE], ids=["more", "less", "more than the load", "more than all"])
def test_a_correction_changes_each_sum_by_its_own_and_none_below_nothing(missed: MissedMass, in_load: bool) -> None:
    masses = (missed.kg, missed.dry_kg, missed.unknown_moisture_kg)
    expected = dict(zip(IN_TOTAL, masses, strict=True))
    if in_load:
        expected |= dict(zip(IN_LOAD, (*masses, missed.unknown_area_kg), strict=True))
    expected = {name: max(change, -getattr(BEGUN, name)) for name, change in expected.items()}
    assert changes(BEGUN, BEGUN.with_missed(missed, in_load=in_load)) == pytest.approx(expected)


KNOWN = MassBudget(noise_kg2=9.0, parameters_kg=2.0, zero_kg=1.0, moisture_kg=0.5, motion_kg=-0.25)


def test_a_corrected_mass_is_as_sure_in_proportion() -> None:
    before = replace(BEGUN, total_budget=KNOWN, load_budget=KNOWN)
    after = before.with_missed(MissedMass(kg=10.0), in_load=True)
    for budget, factor in ((after.total_budget, 1.01), (after.load_budget, 1.1)):
        found = (budget.noise_kg2, budget.parameters_kg, budget.zero_kg, budget.moisture_kg, budget.motion_kg)
        assert found == pytest.approx((9.0 * factor, 2.0 * factor, factor, 0.5 * factor, -0.25 * factor))
    apart = before.with_missed(MissedMass(kg=10.0), in_load=False)
    assert (apart.load_budget, apart.total_budget) == (KNOWN, after.total_budget)
    doubted = replace(before, load_budget=replace(KNOWN, zero_kg=12.0)).with_missed(MissedMass(kg=10.0), in_load=True)
    assert doubted.load_budget.zero_kg == pytest.approx(2.0), "what the zero missed is found"
    fresh = replace(before, load_kg=0.0).with_missed(MissedMass(kg=10.0), in_load=True)
    assert isnan(fresh.load_budget.std_dev_kg), "nothing is known of how sure the new mass is"


@pytest.mark.parametrize("is_open", [True, False])
def test_masses_from_apart_join_the_total_and_an_open_load(is_open: bool) -> None:
    before = replace(BEGUN, total_budget=KNOWN, load_budget=KNOWN, load_open=is_open)
    more = replace(BEGUN, total_budget=KNOWN, load_kg=3.0, load_dry_kg=2.0, load_area_m2=900.0, load_number=77)
    after = before.with_more(more)
    total = {"total_kg": 1000.0, "total_dry_kg": 600.0, "total_unknown_moisture_kg": 300.0, "total_contested_kg": 70.0}
    load = {name.replace("total", "load"): kg for name, kg in total.items()} | {"load_unknown_area_kg": 1000.0}
    assert changes(before, after) == pytest.approx(total | (load if is_open else {}))
    twice = MassBudget(noise_kg2=18.0, parameters_kg=4.0, zero_kg=2.0, moisture_kg=1.0, motion_kg=-0.5)
    assert (after.total_budget, after.load_budget) == (twice, twice if is_open else KNOWN)
    assert (after.load_number, after.load_open, after.market_moisture_pct) == (4, is_open, 14.0)


@pytest.mark.parametrize("is_open", [True, False])
def test_the_error_of_mass_is_counted_where_the_mass_is(is_open: bool) -> None:
    before = replace(BEGUN, total_budget=KNOWN, load_budget=KNOWN, load_open=is_open)
    after = before.with_mass(10.0, None, FlowBudget(2.0, 0.5, 0.25, 0.125), 2.0)
    more = MassBudget(noise_kg2=9.0 + 16.0, parameters_kg=3.0, zero_kg=1.5, moisture_kg=0.75, motion_kg=-0.25)
    assert (after.total_budget, after.load_budget) == (more, more if is_open else KNOWN)


@pytest.mark.parametrize("is_open", [True, False])
@pytest.mark.parametrize(
    ("area_m2", "expected"),
    [(40.0, {"load_area_m2": 40.0}), (0.0, {}), (float("nan"), {"load_unknown_area_kg": 10.0})],
    ids=["known", "none", "not known"],
)
def test_area_or_mass_without_one_belongs_to_an_open_load(area_m2: float, expected: dict[str, float], is_open: bool) -> None:
    before = replace(BEGUN, load_open=is_open)
    expected = expected if is_open else {}
    assert changes(before, before.with_area(area_m2, 10.0)) == pytest.approx(expected)
    found = changes(before, before.with_mass(10.0, 9.0, area_m2=area_m2))
    assert {name: change for name, change in found.items() if "area" in name} == pytest.approx(expected)


def test_a_new_load_holds_nothing_and_the_total_all() -> None:
    before = replace(BEGUN, total_budget=KNOWN, load_budget=KNOWN, load_open=False, first_load=2)
    after = before.start_load()
    of_load = {item.name: getattr(after, item.name) for item in fields(Totals) if item.name.startswith("load_")}
    assert of_load == {
        item.name: item.default for item in fields(Totals) if item.name.startswith("load_")
    } | {"load_number": 5, "load_open": True, "load_budget": EMPTY}  # fmt: skip
    kept = [item.name for item in fields(Totals) if not item.name.startswith("load_")]
    assert [getattr(after, name) for name in kept] == [getattr(before, name) for name in kept]


@pytest.mark.parametrize(
    ("unknown_kg", "dry_kg"), [(0.0, 60.0), (0.001, None)], ids=["all of known moisture", "a gram that is not"]
)
def test_a_dry_mass_is_known_where_all_moisture_is(unknown_kg: float, dry_kg: float | None) -> None:
    totals = Totals(load_dry_kg=60.0, total_dry_kg=60.0, load_unknown_moisture_kg=unknown_kg)
    assert (totals.known_load_dry_kg, totals.known_total_dry_kg) == (dry_kg, 60.0)
    totals = replace(totals, total_unknown_moisture_kg=unknown_kg, load_unknown_moisture_kg=0.0)
    assert (totals.known_load_dry_kg, totals.known_total_dry_kg) == (60.0, dry_kg)


def test_what_rounding_leaves_of_mass_taken_back_hides_no_dry_mass() -> None:
    totals = Totals().with_mass(9.0, 8.0).with_mass(0.1, None).with_mass(0.2, None)
    back = totals.with_missed(MissedMass(kg=-0.3, unknown_moisture_kg=-0.3), in_load=True)
    assert (totals.known_load_dry_kg, totals.known_total_dry_kg) == (None, None)
    assert back.load_unknown_moisture_kg > 0.0
    assert (back.known_load_dry_kg, back.known_total_dry_kg) == (8.0, 8.0)
