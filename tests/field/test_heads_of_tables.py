"""Tables with titles, units and headers where people put them, decimal commas, workbooks, and options that contradict them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import openpyxl
import pyproj
import pytest

from tests.service.test_store import batch
from yieldmon.cli import main as cli
from yieldmon.field import sources
from yieldmon.field.sources.options import ReadOptions
from yieldmon.service.logs.tables import open_table
from yieldmon.service.storage.store import Store

from .test_processed import harvest
from .test_rows_of_strangers import AREA_M2, MASS_KG, YIELD_T_HA, Row, changed, home, mapped, mass_kg, rows, text  # noqa: F401

GERMAN = {
    "time": "Uhrzeit",
    "longitude": "Längengrad",
    "latitude": "Breitengrad",
    "yield_t_ha": "Ertrag",
    "width_m": "Arbeitsbreite",
}
UNITS = {"Ertrag": "[t/ha]", "Arbeitsbreite": "[m]"}


def german(table: list[Row]) -> tuple[str, str]:
    """Header and body with semicolons and decimal commas."""
    lines = [";".join(str(value).replace(".", ",") for value in row.values()) for row in table]
    return ";".join(GERMAN.get(name, name) for name in table[0]), "\n".join([*lines, ""])


def test_a_title_above_and_units_below_the_header(capsys: pytest.CaptureFixture[str]) -> None:
    header, body = german(rows())
    units = ";".join(UNITS.get(name, "") for name in header.split(";"))
    document, _ = mapped(capsys, f"Export\nMaschine;C760;4711\n\n{header}\n{units}\n{body}")
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)


def test_remarks_above_the_header(capsys: pytest.CaptureFixture[str]) -> None:
    document, _ = mapped(capsys, "# export, version 2\n# of the north field\n" + text(rows()))
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)


def test_a_workbook_with_a_title_over_merged_cells(capsys: pytest.CaptureFixture[str]) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    sheet["A1"] = "Harvest 2024"
    sheet.merge_cells("A1:E1")
    sheet.append([])
    sheet.append(list(rows()[0]))
    for row in rows():
        sheet.append(list(row.values()))
    Path("work").mkdir()
    book.save("work/h.xlsx")
    for source in ("work/h.xlsx", "work"):
        assert cli.main(["map", source, "--out", "unused", "--products", "none", "--json"]) == 0
        assert mass_kg(json.loads(capsys.readouterr().out)) == pytest.approx(MASS_KG, rel=0.01)


def test_a_header_that_comes_again_is_none_of_the_rows(capsys: pytest.CaptureFixture[str]) -> None:
    half = len(rows()) // 2
    document, said = mapped(capsys, text(rows()[:half]) + text(rows()[half:]))
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert "left out" not in said


def test_a_header_of_other_columns_below_the_first_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    half = len(rows()) // 2
    other = [dict(reversed(row.items())) for row in rows()[half:]]
    Path("h.csv").write_text(text(rows()[:half]) + text(other))
    assert cli.main(["map", "h.csv", "--out", "unused"]) == 2
    assert f"h.csv: line {half + 2}: is another header, of other columns; expected a file for each" in capsys.readouterr().err


def test_points_between_thousands_where_decimals_have_commas(capsys: pytest.CaptureFixture[str]) -> None:
    def row_of(_: int, row: Row) -> Row:
        kilograms = round(1000 * row.pop("yield_t_ha"))
        # A point that the text's own change of signs leaves alone.
        return row | {"Ertrag (kg/ha)": f"{kilograms:,}".replace(",", "\N{ONE DOT LEADER}")}

    header, body = german(changed(row_of))
    document, _ = mapped(capsys, f"{header} \n{body}".replace("\N{ONE DOT LEADER}", ".").replace("Arbeitsbreite", "Breite (m)"))
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)


def test_decimal_points_between_semicolons_are_no_thousands(capsys: pytest.CaptureFixture[str]) -> None:
    table = changed(lambda _, row: row | {"yield_t_ha": f"{row['yield_t_ha']:.2f}".replace(".", ","), "width_m": "6.000"})
    document, _ = mapped(capsys, "\n".join([";".join(table[0]), *(";".join(map(str, row.values())) for row in table), ""]))
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)


@pytest.mark.parametrize("words", [(), ("--crs", "EPSG:32632")])
def test_places_on_a_plane_need_its_name(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    to_plane = pyproj.Transformer.from_crs(4326, 32632, always_xy=True)

    def row_of(_: int, row: Row) -> Row:
        east, north = to_plane.transform(row.pop("longitude"), row.pop("latitude"))
        return row | {"Easting": f"{east:.3f}", "Northing": f"{north:.3f}"}

    Path("h.csv").write_text(text(changed(row_of)))
    code = cli.main(["map", "h.csv", "--out", "unused", "--products", "none", *words])
    said = capsys.readouterr().err
    refused = "names no coordinate system and is not in degrees; expected --crs EPSG:CODE" in said
    assert (code, refused) == ((0, False) if words else (2, True))


def test_a_width_in_yards_and_a_harvest_moisture_are_understood(capsys: pytest.CaptureFixture[str]) -> None:
    table = changed(
        lambda _, row: row | {"Swath Width (yd)": f"{row.pop('width_m') / 0.9144:.4f}", "Harvest Moisture (%)": "15.5"}
    )
    document, _ = mapped(capsys, table)
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert sources.read(Path("h0.csv"), ReadOptions()).columns["moisture_pct"] == pytest.approx(15.5)


def test_a_width_in_a_unit_that_is_not_known_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    """ "Has no working width", it said."""
    Path("h.csv").write_text(text(changed(lambda _, row: row | {"Swath Width (ell)": row.pop("width_m")})))
    assert cli.main(["map", "h.csv", "--out", "unused"]) == 2
    said = capsys.readouterr().err
    assert "h.csv: states no known unit for Swath Width (ell); expected --column width=Swath Width (ell):UNIT" in said


@pytest.mark.parametrize("times", [1e-3, 12.0])
def test_a_yield_that_no_crop_has_is_named(times: float, capsys: pytest.CaptureFixture[str]) -> None:
    table = changed(lambda _, row: row | {"yield_t_ha": times * row["yield_t_ha"], "crop": "Wheat"})
    document, said = mapped(capsys, table)
    assert document["yield_t_ha"] == pytest.approx(times * YIELD_T_HA, rel=0.02)
    assert "no crop yields " in said
    assert "t/ha: expected other units of yield, flow or width" in said


def test_two_seasons_on_the_same_ground_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    document, said = mapped(capsys, rows() + rows(start_s=1.7e9 + 365 * 86400.0, longitude=11.00001))
    assert "the harvest has 2 seasons from 2023-11-14 to 2024-11-13 on the same ground" in said
    assert document["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.06)


CROPS = {"one": ["Wheat"] * 2, "none": [""] * 2, "two": ["Wheat", "Oats"], "some": ["Wheat", ""], "hybrid": ["P1366"] * 2}


@pytest.mark.parametrize(
    ("crops", "given", "expected", "says"),
    [
        ("one", "corn", ["corn", "corn"], "the file says Wheat; its rows are named corn, as --crop says"),
        ("one", "wheat", ["wheat", "wheat"], ""),
        ("none", "corn", ["corn", "corn"], ""),
        ("two", "corn", ["Wheat", "Oats"], "rows keep the crop that the file says (Oats, Wheat); --crop corn is for the others"),
        ("some", "wheat", ["wheat", "wheat"], ""),
        ("hybrid", "corn", ["corn", "corn"], ""),
    ],
)
def test_a_crop_of_a_person_is_that_of_rows_without_one(crops: str, given: str, expected: list[str], says: str) -> None:
    half = len(rows()) // 2
    Path("h.csv").write_text(text(changed(lambda n, row: row | {"crop": CROPS[crops][n >= half]})))
    table = sources.read(Path("h.csv"), ReadOptions(crop=given))
    names = table.labels["crop"].text()
    assert [names[0], names[-1]] == expected
    assert (says in table.sources[0].notes) if says else not any("crop" in note for note in table.sources[0].notes)


def test_a_csv_of_process_weighs_what_its_store_weighs(capsys: pytest.CaptureFixture[str]) -> None:
    """Its mass is the integral over the second; the flow that was published is that of a moment of it."""
    measured: list[Any] = [replace(row, mass_flow_kg_s=1.02 * row.mass_flow_kg_s) for row in harvest()]
    with Store(Path("s.sqlite")) as store:
        store.commit([batch(1, seconds=tuple(measured))])
    with open_table("rows.csv") as writer:
        for row in measured:
            writer.write(row)
    found = []
    for source in ("s.sqlite", "rows.csv"):
        assert cli.main(["map", source, "--width", "9", "--out", "unused", "--products", "none", "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out)["mass_kg"]["integrated"])
    assert found[1] == pytest.approx(found[0], rel=1e-6)
    assert found[0] == pytest.approx(sum(row.mass_kg for row in measured), rel=1e-6)
