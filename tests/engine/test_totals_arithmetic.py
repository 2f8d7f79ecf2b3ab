"""Sums of mass, each in its place."""

from __future__ import annotations

from dataclasses import fields

import pytest

from yieldmon.engine.settings import TotalsSettings
from yieldmon.engine.totals import Totals, dry_mass

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
