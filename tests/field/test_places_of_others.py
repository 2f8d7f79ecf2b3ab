"""Places as programs write them: other coordinate systems, degrees in other forms, layers of shapes, slow receivers."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas
import pyproj
import pytest
import shapely

from yieldmon.cli import main as cli

from .test_rows_of_strangers import (  # noqa: F401
    AREA_M2,
    MASS_KG,
    PASS_S,
    SPEED_M_S,
    WIDTH_M,
    YIELD_T_HA,
    Row,
    changed,
    home,
    mapped,
    mass_kg,
    rows,
    text,
)

UTM = "EPSG:32632"


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, Any, str]:
    code = cli.main(["map", *words, "--out", "unused", "--products", "none", "--json"])
    said = capsys.readouterr()
    return code, json.loads(said.out) if code == 0 else None, said.err


def is_the_harvest(document: Any, times: float = 1.0, area: float = 0.02) -> None:
    assert mass_kg(document) == pytest.approx(times * MASS_KG, rel=0.01)
    assert document["area_ha"] * 1e4 == pytest.approx(times * AREA_M2, rel=area)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)


def frame(table: list[Row], crs: str = "EPSG:4326") -> geopandas.GeoDataFrame:
    data = pandas.DataFrame(table)
    places = geopandas.points_from_xy(data.pop("longitude"), data.pop("latitude"), crs="EPSG:4326")
    data["time"] = pandas.to_datetime(data["time"], unit="s", utc=True).dt.strftime("%Y-%m-%dT%H:%M:%SZ")
    return geopandas.GeoDataFrame(data, geometry=places).to_crs(crs)


def polygons(table: list[Row]) -> geopandas.GeoDataFrame:
    """The ground of each row: passes run north and south."""
    data = frame(table, UTM)
    wide, long = WIDTH_M / 2, SPEED_M_S / 2
    data.geometry = [shapely.box(place.x - wide, place.y - long, place.x + wide, place.y + long) for place in data.geometry]
    return data


@pytest.mark.parametrize("wrong", ["a plane as degrees", "degrees as a plane"])
def test_places_that_are_not_of_the_system_that_the_file_names(wrong: str, capsys: pytest.CaptureFixture[str]) -> None:
    plane = wrong == "a plane as degrees"
    data = frame(rows(), UTM) if plane else frame(rows())
    data.set_crs("EPSG:4326" if plane else UTM, allow_override=True).to_file("h.gpkg")
    code, _, said = run(capsys, "h.gpkg")
    assert code == 2
    assert len(said.splitlines()) == 1
    assert f"which {'is not' if plane else 'is'} in degrees; expected --crs EPSG:CODE" in said
    code, document, said = run(capsys, "h.gpkg", "--crs", UTM if plane else "EPSG:4326")
    assert code == 0, said
    assert "its places are not of" in said
    is_the_harvest(document)


def test_a_system_of_a_person_is_not_that_of_degrees(capsys: pytest.CaptureFixture[str]) -> None:
    """Of several files some name no system and one has degrees."""
    document, said = mapped(capsys, rows(), words=("--crs", UTM))
    assert "its coordinates are degrees and not of EPSG:32632" in said
    is_the_harvest(document)


@pytest.mark.parametrize("form", ["east of Greenwich", "exchanged"])
def test_degrees_that_can_only_be_meant_in_one_way(form: str, capsys: pytest.CaptureFixture[str]) -> None:
    def other(_: int, row: Row) -> Row:
        if form == "exchanged":
            return row | {"longitude": row["latitude"], "latitude": row["longitude"]}
        return row | {"longitude": row["longitude"] + 360.0}

    document, said = mapped(capsys, changed(other, rows(latitude=42.0, longitude=-93.0)))
    assert ("longitude and latitude are exchanged" in said) == (form == "exchanged")
    is_the_harvest(document)


@pytest.mark.parametrize(("unit", "times"), [("1e-7deg", 1e7), ("1e-6deg", 1e6), ("rad", np.pi / 180.0)])
def test_degrees_in_other_units(unit: str, times: float, capsys: pytest.CaptureFixture[str]) -> None:
    table = changed(lambda _, row: row | {one: row[one] * times for one in ("longitude", "latitude")})
    document, _ = mapped(
        capsys, table, words=("--column", f"longitude=longitude:{unit}", "--column", f"latitude=latitude:{unit}")
    )
    is_the_harvest(document)


def test_whole_numbers_that_are_no_degrees_ask_for_a_unit(capsys: pytest.CaptureFixture[str]) -> None:
    Path("h.csv").write_text(
        text(changed(lambda _, row: row | {one: round(row[one] * 1e7) for one in ("longitude", "latitude")}))
    )
    code, _, said = run(capsys, "h.csv")
    assert code == 2
    assert "or a unit, such as --column longitude=longitude:1e-7deg" in said


def test_exchanged_places_of_passes_at_an_angle_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    """Passes at 25 degrees from north, and headlands across them."""
    table = rows(speeds=False)
    plane = pyproj.Proj(proj="aeqd", lat_0=48.0, lon_0=11.0)
    x, y = plane([row["longitude"] for row in table], [row["latitude"] for row in table])
    along = 2.0 * np.arange(PASS_S)
    x, y = np.append(x, along), np.append(y, np.full(PASS_S, -20.0))
    turn = np.radians(25.0)
    longitude, latitude = plane(x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), inverse=True)
    last = table[-1]
    table += [last | {"time": last["time"] + 20.0 + number} for number in range(PASS_S)]
    told = [
        row | {"longitude": north, "latitude": east, "distance_m": SPEED_M_S}
        for row, east, north in zip(table, longitude, latitude, strict=True)
    ]
    _, said = mapped(capsys, told)
    assert "longitude and latitude seem exchanged" in said


@pytest.mark.parametrize("kept", [5, 3])
def test_a_receiver_slower_than_the_log_costs_no_ground(kept: int, capsys: pytest.CaptureFixture[str]) -> None:
    table = rows(speeds=False)
    held = [row | {one: table[n - n % PASS_S % kept][one] for one in ("longitude", "latitude")} for n, row in enumerate(table)]
    document, said = mapped(capsys, held)
    assert "rows are interpolated between them" in said
    is_the_harvest(document)


def test_rounded_places_are_said_and_contradict_no_unit(capsys: pytest.CaptureFixture[str]) -> None:
    table = changed(
        lambda _, row: row | {"distance_m": SPEED_M_S} | {one: round(row[one], 4) for one in ("longitude", "latitude")}
    )
    document, said = mapped(capsys, table)
    assert "rows are interpolated between them" in said
    assert "expected another unit" not in said
    assert "exchanged" not in said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)


def test_all_layers_of_shapes_are_read(capsys: pytest.CaptureFixture[str]) -> None:
    geopandas.GeoDataFrame({"name": ["edge"]}, geometry=[shapely.box(10.9, 47.9, 11.1, 48.1)], crs=4326).to_file(
        "h.gpkg", layer="a boundary"
    )
    polygons(rows()).to_file("h.gpkg", layer="north")
    polygons(rows(latitude=48.1, start_s=1.7e9 + 86_400)).to_file("h.gpkg", layer="south")
    code, document, said = run(capsys, "h.gpkg")
    assert code == 0, said
    is_the_harvest(document, times=2.0)
    assert "layer a boundary: has no column of flow or yield" in said


def test_layers_of_machines_at_once_are_not_mixed(capsys: pytest.CaptureFixture[str]) -> None:
    frame(rows()).to_file("h.gpkg", layer="red")
    frame(rows(latitude=48.1), UTM).to_file("h.gpkg", layer="blue")
    code, document, said = run(capsys, "h.gpkg")
    assert code == 0, said
    is_the_harvest(document, times=2.0)
    assert "mixed" not in said


@pytest.mark.parametrize("first", ["remarks", "another field"])
def test_all_sheets_of_a_workbook_are_read(first: str, capsys: pytest.CaptureFixture[str]) -> None:
    other = rows(latitude=48.1, start_s=1.7e9 + 86_400) if first == "another field" else [{"made by": "hand"}]
    with pandas.ExcelWriter("h.xlsx") as book:
        pandas.DataFrame(other).to_excel(book, sheet_name=first, index=False)
        pandas.DataFrame(rows()).to_excel(book, sheet_name="harvest", index=False)
    code, document, said = run(capsys, "h.xlsx")
    assert code == 0, said
    is_the_harvest(document, times=2.0 if first == "another field" else 1.0)
    assert ("sheet remarks: has no column of flow or yield" in said) == (first == "remarks")


@pytest.mark.parametrize(("down", "up"), [(0, 1), (12, 85), ("raised", "lowered")])
def test_a_header_that_the_grain_contradicts_is_not_used(down: Any, up: Any, capsys: pytest.CaptureFixture[str]) -> None:
    table = changed(lambda n, row: row | {"header": up if n % PASS_S < 4 else down, "moisture": 15.0})
    document, said = mapped(capsys, table)
    assert "of the grain is measured while the header status is up: the status is not used" in said
    is_the_harvest(document)


def test_a_height_is_no_state(capsys: pytest.CaptureFixture[str]) -> None:
    document, said = mapped(capsys, changed(lambda n, row: row | {"header": n % 37 + 1}))
    assert "header holds 37 different numbers, so it is not a header state" in said
    is_the_harvest(document)


def test_a_moisture_of_no_crop_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    _, said = mapped(capsys, changed(lambda _, row: row | {"moisture": 0.155}))
    assert "no crop has a moisture of 0.15 %; expected another unit (--column moisture=moisture:fraction)" in said


def test_a_mass_that_goes_on_is_a_sum(capsys: pytest.CaptureFixture[str]) -> None:
    kg_of_row = [row["yield_t_ha"] / 10.0 * SPEED_M_S * WIDTH_M for row in rows()]
    total = np.cumsum(kg_of_row)
    table = [
        {k: v for k, v in row.items() if k != "yield_t_ha"} | {"total_kg": kg} for row, kg in zip(rows(), total, strict=True)
    ]
    document, said = mapped(capsys, table, words=("--column", "mass=total_kg:kg"))
    assert "total_kg is a running total: its differences are used as masses" in said
    is_the_harvest(document)


@pytest.mark.parametrize("quantity", ["flow", "yield"])
def test_minutes_that_are_taken_as_seconds_are_named(quantity: str, capsys: pytest.CaptureFixture[str]) -> None:
    start_s = rows()[0]["time"]

    def row_of(_: int, row: Row) -> Row:
        kg_m2 = row.pop("yield_t_ha") / 10.0
        said = {"flow_kg_s": kg_m2 * SPEED_M_S * WIDTH_M} if quantity == "flow" else {"yield_t_ha": kg_m2 * 10.0}
        return row | {"time": (row["time"] - start_s) / 60.0} | said

    Path("h.csv").write_text(text(changed(row_of)))
    code, _, said = run(capsys, "h.csv")
    if quantity == "flow":
        assert code == 0, said
        assert "m/s: expected other units of time, place, distance or speed" in said
    else:
        assert code == 2
        assert "cannot be a harvest: 960 values of flow_kg_s outside 0 to 300 are taken as unknown" in said


def test_areas_across_the_date_line_are_parts_on_either_side(capsys: pytest.CaptureFixture[str]) -> None:
    Path("h.csv").write_text(text(rows(longitude=179.9997, latitude=-17.0)))
    assert cli.main(["map", "h.csv", "--out", "made", "--products", "geopackage"]) == 0, capsys.readouterr().err
    for layer in ("swaths", "grid"):
        areas = geopandas.read_file("made/harvest.gpkg", layer=layer)
        assert areas.is_valid.all()
        parts = areas.explode().bounds
        assert parts.minx.min() >= -180.0
        assert parts.maxx.max() <= 180.0
        assert (parts.maxx - parts.minx).max() < 0.001
        assert len(parts) > len(areas)
        ground_m2 = areas.to_crs("+proj=laea +lat_0=-17 +lon_0=180").area.sum()
        assert ground_m2 == pytest.approx(AREA_M2, rel=0.01 if layer == "swaths" else 0.2)


def test_worst_areas_across_the_date_line_have_longitudes(capsys: pytest.CaptureFixture[str]) -> None:
    Path("h.csv").write_text(text(rows(longitude=179.9997, latitude=-17.0)))
    assert cli.main(["map", "h.csv", "--out", "made", "--products", "report"]) == 0, capsys.readouterr().err
    found = re.findall(r'"name": ?"-1[67]\.\d+, (-?\d+\.\d+)"', Path("made/report.html").read_text())
    longitudes = [float(one) for one in found]
    assert min(longitudes) < 0 < max(longitudes)
    assert max(longitudes) < 180.0


def test_ground_is_where_grain_was_cut_also_without_a_header(capsys: pytest.CaptureFixture[str]) -> None:
    """Raw flow, 12 s after the grain was cut, of passes with turns of 20 s; once with the header's state and once without."""
    generator = np.random.default_rng(5)
    patches = 0.8 + 0.2 * np.convolve(generator.normal(size=700), np.ones(25) / 5.0, "same")
    turn_s, found = 20, {}
    table, cut = [], []
    for lane in range(16):
        first = rows()[0]
        for second in range(PASS_S + turn_s):
            down = second < PASS_S
            way = SPEED_M_S * second if down else SPEED_M_S * PASS_S + 15.0 * np.sin(np.pi * (second - PASS_S) / turn_s)
            north = way if lane % 2 == 0 else SPEED_M_S * PASS_S - way
            east = WIDTH_M * (lane + (0.0 if down else (second - PASS_S) / turn_s))
            kg_s = patches[int(north) + 20 + 3 * lane] * SPEED_M_S * WIDTH_M
            table.append(
                {
                    "time": first["time"] + len(table),
                    "longitude": first["longitude"] + east / (111_320.0 * np.cos(np.radians(48.0))),
                    "latitude": first["latitude"] + north / 111_195.0,
                    "width_m": WIDTH_M,
                    "header": "down" if down else "up",
                }
            )
            cut.append(max(kg_s, 0.05) if down else 0.0)
    flow = np.r_[np.zeros(12), cut[:-12]]
    for said in (True, False):
        told = [
            {k: v for k, v in row.items() if said or k != "header"} | {"flow_kg_s": kg_s}
            for row, kg_s in zip(table, flow, strict=True)
        ]
        found[said], _ = mapped(capsys, told, words=("--flow-delay", "12"))
    assert found[True]["area_ha"] * 1e4 == pytest.approx(16 * PASS_S * SPEED_M_S * WIDTH_M, rel=0.02)
    assert found[False]["area_ha"] == pytest.approx(found[True]["area_ha"], rel=0.003)
    assert found[False]["mass_kg"]["kept"] == pytest.approx(found[True]["mass_kg"]["kept"], rel=0.003)
    assert found[False]["yield_t_ha"] == pytest.approx(found[True]["yield_t_ha"], rel=0.003)
