"""`load list --sums`: what a field and crop gave, in one row for each harvest of them."""

from __future__ import annotations

from typing import Any

import pytest

from yieldmon.cli._load_sums import load_sums, sum_rows

DAY_S = 86_400.0
BEGIN_S = 1_790_000_000.0


def load(number: int, field: str, crop: str, day: float, mass_kg: float = 1000.0, **more: Any) -> Any:
    return {
        "number": number, "field": field, "crop": crop, "started_s": BEGIN_S + day * DAY_S,
        "ended_s": BEGIN_S + (day + 0.1) * DAY_S, "mass_kg": mass_kg, "dry_mass_kg": 0.9 * mass_kg, "area_m2": 1250.0,
        "posted_mass_kg": None, "ticket_mass_kg": None, "corrected_mass_kg": 1.1 * mass_kg,
        "corrected_dry_mass_kg": 0.99 * mass_kg, "ticket_id": None, "std_dev_kg": 50.0,
        "corrected_std_dev_kg": 30.0,
    } | more  # fmt: skip


@pytest.mark.parametrize(
    ("loads", "expected"),
    [
        ([], []),
        ([load(1, "", "", 0.0, 0.0)], []),
        (
            [load(1, "n", "corn", 0, ticket_id=3), load(2, "s", "corn", 1), load(3, "n", "corn", 2), load(4, "n", "wheat", 3)],
            [("n", "corn", 2, 1, 2000.0), ("s", "corn", 1, 0, 1000.0), ("n", "wheat", 1, 0, 1000.0)],
        ),
        ([load(1, "n", "corn", 0), load(2, "n", "corn", 365)], [("n", "corn", 1, 0, 1000.0)] * 2),
        ([load(1, "n", "corn", 0), load(2, "n", "corn", 80), load(3, "n", "corn", 160)], [("n", "corn", 3, 0, 3000.0)]),
        ([load(1, "n", "corn", 0, ended_s=None), load(2, "n", "corn", 1, started_s=None)], [("n", "corn", 2, 0, 2000.0)]),
    ],
)
def test_loads_of_a_field_and_crop_are_summed_up(loads: list[Any], expected: list[tuple[Any, ...]]) -> None:
    found = load_sums(loads)
    keys = ("field", "crop", "loads", "weighed", "mass_kg")
    assert [tuple(row[key] for key in keys) for row in found] == expected  # type: ignore[literal-required]
    assert sum(row["corrected_mass_kg"] for row in found) == pytest.approx(sum(one["corrected_mass_kg"] for one in loads))


def test_what_one_load_does_not_know_its_sum_does_not_either() -> None:
    loads = [load(1, "n", "corn", 0), load(2, "n", "corn", 1, corrected_dry_mass_kg=None, area_m2=None)]
    [found] = load_sums(loads)
    assert (found["corrected_dry_mass_kg"], found["area_m2"]) == (None, None)
    _, [row] = sum_rows([found], "metric")
    assert row[4:] == ["2", "0", "2,000 kg", "2,200 kg", "60.0 kg", "-", "-", "-"]


@pytest.mark.parametrize(
    ("tickets", "expected"),
    [((None, None), 60.0), ((1, 1), 60.0), ((1, 2), 1800.0**0.5), ((1, None), 1800.0**0.5)],
)
def test_a_sum_is_as_uncertain_as_what_its_loads_share(tickets: tuple[int | None, ...], expected: float) -> None:
    """Loads without a ticket, or on one, are off alike; two tickets are not."""
    loads = [load(n, "n", "corn", n, ticket_id=ticket) for n, ticket in enumerate(tickets, 1)]
    [found] = load_sums(loads)
    assert found["corrected_std_dev_kg"] == pytest.approx(expected)
    [unknown] = load_sums([*loads, load(3, "n", "corn", 3, corrected_std_dev_kg=None)])
    assert unknown["corrected_std_dev_kg"] is None


@pytest.mark.parametrize(
    ("units", "expected"),
    [
        ("metric", ["2,000 kg", "2,200 kg", "60.0 kg", "1,980 kg", "0.25 ha", "8.80 t/ha"]),
        ("us", ["4,409 lb", "4,850 lb", "132 lb", "4,365 lb (77.9 bu)", "0.62 ac", "140 bu/ac"]),
    ],
)
def test_sums_in_both_systems_of_units(units: str, expected: list[str]) -> None:
    _, [row] = sum_rows(load_sums([load(1, "n", "corn", 0), load(2, "n", "corn", 1)]), units)
    assert row[6:] == expected
