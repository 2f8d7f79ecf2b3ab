"""A row for each section of the header, with and without a number, at places of their own or all at the machine's."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from .synthetic import EARTH_M_DEG
from .test_rows_of_strangers import AREA_M2, MASS_KG, WIDTH_M, YIELD_T_HA, Row, home, mapped, mass_kg, rows  # noqa: F401

SECTIONS = 4
EAST_DEG = WIDTH_M / SECTIONS / (EARTH_M_DEG * np.cos(np.radians(48.0)))


def of_sections(number: str, *, beside: bool, clock: str = "s") -> list[Row]:
    """number: name of its column, "" for none. beside: places of their own. clock: s, or whole seconds behind a log of 0.96 s."""
    found = []
    for row in rows():
        for section in range(SECTIONS):
            east = (section - (SECTIONS - 1) / 2) * EAST_DEG if beside else 0.0
            made = row | {"longitude": row["longitude"] + east, "width_m": WIDTH_M / SECTIONS}
            if clock == "whole":
                moment = np.floor(1.7e9 + (row["time"] - 1.7e9) * 0.96)
                made |= {"time": datetime.fromtimestamp(moment, UTC).strftime("%m/%d/%Y %I:%M:%S %p")}
            found.append(made | ({number: section} if number else {}))
    return found


@pytest.mark.parametrize("number", ["section", "SECTIONID", "Boom Section", ""])
@pytest.mark.parametrize("distance", [True, False])
def test_sections_side_by_side_cut_the_whole_width(number: str, distance: bool, capsys: pytest.CaptureFixture[str]) -> None:
    table = of_sections(number, beside=True)
    document, said = mapped(capsys, [row | {"distance_m": 2.0} for row in table] if distance else table)
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert document["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.01)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)
    assert ("they are taken as 4 sections of the header" in said) == (not number)


def test_sections_at_the_machine_s_place_cut_the_whole_width(capsys: pytest.CaptureFixture[str]) -> None:
    document, said = mapped(capsys, of_sections("section", beside=False))
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert document["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.01)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)
    assert "3840 rows are taken together to 960" in said


def test_a_clock_of_whole_seconds_costs_sections_no_grain(capsys: pytest.CaptureFixture[str]) -> None:
    """Where two steps of the header have the same time, the second is no row without an interval."""
    document, said = mapped(capsys, of_sections("section", beside=True, clock="whole"))
    assert "times are evened out" in said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert document["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.02)


def test_two_machines_at_once_are_no_sections(capsys: pytest.CaptureFixture[str]) -> None:
    both = [row for pair in zip(rows(), rows(longitude=11.004), strict=True) for row in pair]
    document, said = mapped(capsys, both)
    assert "sections" not in said
    assert mass_kg(document) == pytest.approx(2 * MASS_KG, rel=0.01)
