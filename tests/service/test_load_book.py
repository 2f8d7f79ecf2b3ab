"""What is written of a load, and from which unknown mass on its dry mass and its area are not known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.engine.mass.missed_mass import MissedMass
from yieldmon.service.history.load_book import LoadBook
from yieldmon.service.logs.recorded import read_loads
from yieldmon.service.storage.batch import Batch, Load
from yieldmon.service.storage.store import Store

SUMMARY = LoadSummary(
    number=3, start_s=10.0, end_s=20.0, measured_kg=100.0, dry_kg=85.0, unknown_moisture_kg=0.0, complete=True, area_m2=50.0
)
NAN = float("nan")


def book(*loads: Load) -> LoadBook:
    return LoadBook(loads)


def written(**changes: Any) -> Load:
    found = book()
    found.measured(replace(SUMMARY, **changes), "south", "corn")
    (load,) = found.take()
    return load


KNOWN = written()


def test_a_load_as_it_is_measured() -> None:
    assert (
        Load(number=3, field="south", crop="corn", started_s=10.0, ended_s=20.0, mass_kg=100.0, dry_mass_kg=85.0, area_m2=50.0)
        == KNOWN
    )
    assert (written(end_s=NAN).ended_s, written(start_s=NAN).started_s) == (None, None)


@pytest.mark.parametrize(
    ("changes", "dry_kg", "area_m2"),
    [
        ({"unknown_moisture_kg": 1e-6}, 85.0, 50.0),
        ({"unknown_moisture_kg": 1.001e-6}, None, 50.0),
        ({"unknown_area_kg": 2.0}, 85.0, 50.0),
        ({"unknown_area_kg": 2.001}, 85.0, None),
        ({"area_m2": 0.0}, 85.0, None),
        ({"area_m2": 0.5}, 85.0, 0.5),
        ({"measured_kg": 0.0}, 85.0, 50.0),
    ],
)
def test_dry_mass_and_area_are_known_up_to_a_little(changes: dict[str, Any], dry_kg: float | None, area_m2: float | None) -> None:
    load = written(**changes)
    assert (load.dry_mass_kg, load.area_m2) == (dry_kg, area_m2)


@pytest.mark.parametrize(
    ("missed", "mass_kg", "dry_kg", "area_m2"),
    [
        (MissedMass(10.0, 8.0), 110.0, 93.0, 50.0),
        (MissedMass(-10.0, -8.0), 90.0, 77.0, 50.0),
        (MissedMass(-200.0, -200.0), 0.0, 0.0, 50.0),
        (MissedMass(10.0, 8.0, 1e-6), 110.0, 93.0, 50.0),
        (MissedMass(10.0, 8.0, 1.001e-6), 110.0, None, 50.0),
        (MissedMass(25.0, 20.0, 0.0, 2.5), 125.0, 105.0, 50.0),
        (MissedMass(25.0, 20.0, 0.0, 2.501), 125.0, 105.0, None),
    ],
)
def test_missed_mass_is_added(missed: MissedMass, mass_kg: float, dry_kg: float | None, area_m2: float | None) -> None:
    found = book(KNOWN)
    found.corrected(3, missed)
    assert found.take() == (replace(KNOWN, mass_kg=mass_kg, dry_mass_kg=dry_kg, area_m2=area_m2),)


def test_missed_mass_of_a_load_without_dry_mass_does_not_make_one() -> None:
    found = book(replace(KNOWN, dry_mass_kg=None, area_m2=None))
    found.corrected(3, MissedMass(10.0, 8.0))
    found.corrected(4, MissedMass(10.0, 8.0))
    assert found.take() == (replace(KNOWN, mass_kg=110.0, dry_mass_kg=None, area_m2=None),)


def test_what_was_known_stays_and_only_what_changed_is_brought() -> None:
    earlier = replace(KNOWN, field="north", crop="wheat", started_s=5.0)
    found = book(earlier, replace(KNOWN, number=1))
    found.measured(SUMMARY, "south", "corn")
    assert found.take() == ()
    found.measured(replace(SUMMARY, measured_kg=120.0), "south", "corn")
    assert found.take() == (replace(earlier, mass_kg=120.0),)
    assert found.take() == ()
    found.report_all()
    assert sorted(load.number for load in found.take()) == [1, 3]
    assert [load.number for load in found] == [1, 3]
    unstarted = book(replace(KNOWN, started_s=None))
    unstarted.measured(SUMMARY, "", "")
    assert unstarted.take() == (KNOWN,)


def test_a_load_that_a_sweep_shows_to_be_less_sure_is_stated_so(tmp_path: Path) -> None:
    found = book()
    with Store(tmp_path / "s.sqlite") as store:
        for number, std_dev_kg in enumerate((NAN, 0.6, 4.5), 1):
            found.measured(replace(SUMMARY, std_dev_kg=std_dev_kg), "south", "corn")
            store.commit([Batch(number, float(number), {}, loads=found.take())])
            (row,) = store.corrected_loads()
            assert row["std_dev_kg"] == (None if number == 1 else std_dev_kg)
        assert (row["mass_kg"], row["area_m2"]) == (100.0, 50.0)
    (record,) = read_loads(tmp_path / "s.sqlite")
    assert record.std_dev_kg == 4.5


@pytest.mark.parametrize(
    "lost",
    [{"area_m2": None}, {"std_dev_kg": None}, {"dry_mass_kg": None}, {"area_m2": None, "std_dev_kg": None, "dry_mass_kg": None}],
)
def test_what_is_not_known_of_a_load_any_more_is_not_in_the_store(lost: dict[str, None], tmp_path: Path) -> None:
    """While it is open a load is written each second: the speed that fails in the middle leaves no area, not the first half's."""
    whole, other = replace(KNOWN, std_dev_kg=2.0), replace(KNOWN, number=4, std_dev_kg=3.0)
    with Store(tmp_path / "s.sqlite") as store:
        store.commit([Batch(1, 1.0, {}, loads=(whole, other))])
        store.commit([Batch(2, 2.0, {}, loads=(replace(whole, **lost),))])
        assert store.loads() == [replace(whole, **lost), other]


@pytest.mark.parametrize(
    ("dried_kg", "changes", "expected_kg"),
    [
        (90.0, {"std_dev_kg": 4.5}, 90.0),
        (90.0, {"measured_kg": 120.0, "dry_kg": 102.0}, 108.0),
        (90.0, {"unknown_moisture_kg": 5.0}, None),
        (None, {"std_dev_kg": 4.5}, None),
        (None, {"measured_kg": 120.0, "dry_kg": 102.0}, None),
    ],
)
def test_a_load_of_another_crop_keeps_its_dry_mass_when_it_is_restated(
    dried_kg: float | None, changes: dict[str, Any], expected_kg: float | None
) -> None:
    """A sweep after the correction states another deviation of the load, or an undone zero another mass."""
    found = book()
    found.measured(SUMMARY, "south", "corn")
    found.named(3, None, "wheat")
    found.dried(3, 95.0)
    found.dried(3, dried_kg)
    found.measured(replace(SUMMARY, **changes), "south", "corn")
    (load,) = found.take()
    assert (load.crop, load.dry_mass_kg) == ("wheat", expected_kg)
    assert load.mass_kg == changes.get("measured_kg", 100.0)


def test_a_load_whose_doubted_zero_is_corrected_is_as_sure_as_by_the_one_before() -> None:
    doubted = MassBudget(noise_kg2=16.0, parameters_kg=2.0, zero_kg=100.0)
    found = book(replace(KNOWN, std_dev_kg=doubted.std_dev_kg, budget=doubted))
    found.corrected(3, MissedMass(kg=100.0))
    (load,) = found.take()
    assert load.budget == MassBudget(noise_kg2=32.0, parameters_kg=4.0)
    assert load.std_dev_kg == load.budget.std_dev_kg


def test_a_corrected_load_is_relatively_as_sure_as_before() -> None:
    found = book(replace(KNOWN, std_dev_kg=2.0))
    found.corrected(3, MissedMass(kg=50.0))
    (load,) = found.take()
    assert (load.mass_kg, load.std_dev_kg) == (150.0, 3.0)
