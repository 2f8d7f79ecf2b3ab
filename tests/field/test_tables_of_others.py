"""CSV files as other programs write them: thousands, bushels of several crops, sums, a line of units, words of states."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

SECONDS, PASS_S, SPEED_M_S, WIDTH_M, FLOW_KG_S = 600, 100, 1.5, 6.0, 10.0
MASS_KG = SECONDS * FLOW_KG_S
POUND_KG, ACRE_M2, FOOT_M = 0.45359237, 4046.8564224, 0.3048
YIELD_KG_M2 = FLOW_KG_S / (SPEED_M_S * WIDTH_M)


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@dataclass(frozen=True)
class Point:
    """Of a row: its second, and its place."""

    second: int
    longitude: float
    latitude: float


def points() -> list[Point]:
    found = []
    for second in range(SECONDS):
        lane, along = divmod(second, PASS_S)
        way_m = SPEED_M_S * (along if lane % 2 == 0 else PASS_S - along)
        east = 8.0 + way_m / (EARTH_M_DEG * np.cos(np.radians(51.0)))
        found.append(Point(second, east, 51.0 + WIDTH_M * lane / EARTH_M_DEG))
    return found


def mapped(
    capsys: pytest.CaptureFixture[str], head: str, row: Callable[[Point], str], *words: str
) -> tuple[int, dict[str, Any], str]:
    Path("h.csv").write_text("\n".join([head, *map(row, points()), ""]))
    code = cli.main(["map", "h.csv", "--out", "unused", "--products", "none", "--json", *words])
    said = capsys.readouterr()
    return code, json.loads(said.out) if said.out else {}, said.err


def mass_kg(document: dict[str, Any]) -> float:
    return float(document["mass_kg"]["integrated"])


PLACE, HEAD = "{0.second},{0.longitude:.8f},{0.latitude:.8f}", "time (s),longitude,latitude"


def test_thousands_have_commas(capsys: pytest.CaptureFixture[str]) -> None:
    pounds = f'"{YIELD_KG_M2 * ACRE_M2 / POUND_KG:,.2f}"'
    code, document, said = mapped(capsys, f"{HEAD},yield (lb/ac),width (m)", lambda at: f"{PLACE.format(at)},{pounds},6")
    assert code == 0, said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.035)


def test_thousands_have_points_and_decimals_commas(capsys: pytest.CaptureFixture[str]) -> None:
    kilograms = f"{YIELD_KG_M2 * 1e4:,.1f}".translate(str.maketrans(",.", ".,"))
    code, document, said = mapped(
        capsys,
        f"{HEAD};Ertrag (kg/ha);Breite (m)".replace(",", ";"),
        lambda at: f"{PLACE.format(at).replace(',', ';').replace('.', ',')};{kilograms};6,0",
    )
    assert code == 0, said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.035)


def test_a_comma_that_may_be_either_is_no_number(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, said = mapped(capsys, f"{HEAD},yield (t/ha),width (m)", lambda at: f'{PLACE.format(at)},"7,123",6')
    assert code == 2
    assert "no row that can be read (a field that is not a number, such as '7,123')" in said


@pytest.mark.parametrize("words", [(), ("--crop", "wheat")])
def test_bushels_are_those_of_each_row_s_crop(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    def row(at: Point) -> str:
        crop, pounds = ("Wheat", 60.0) if at.second < SECONDS / 2 else ("Oats", 32.0)
        return f"{PLACE.format(at)},{YIELD_KG_M2 * ACRE_M2 / (POUND_KG * pounds):.4f},6,{crop}"

    code, document, said = mapped(capsys, f"{HEAD},yield (bu/ac),width (m),crop", row, *words)
    assert code == 0, said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.035)
    assert "bushels are those of each row's own crop (Oats, Wheat)" in said


def test_a_distance_that_goes_on_is_a_sum(capsys: pytest.CaptureFixture[str]) -> None:
    code, document, said = mapped(
        capsys,
        f"{HEAD},yield (t/ha),width (m),distance (ft)",
        lambda at: f"{PLACE.format(at)},{YIELD_KG_M2 * 10},6,{(at.second + 1) * SPEED_M_S / FOOT_M:.4f}",
    )
    assert code == 0, said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.035)
    assert "distance (ft) is a running total" in said


@pytest.mark.parametrize(("name", "value"), [("speed (km/h)", SPEED_M_S), ("distance (in)", SPEED_M_S / FOOT_M)])
def test_a_unit_that_the_places_contradict_is_named(name: str, value: float, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, said = mapped(
        capsys, f"{HEAD},yield (t/ha),width (m),{name}", lambda at: f"{PLACE.format(at)},{YIELD_KG_M2 * 10},6,{value:.4f}"
    )
    assert code == 0, said
    assert "times the distance between positions; expected another unit" in said


def test_a_line_of_units_and_one_of_the_separator(capsys: pytest.CaptureFixture[str]) -> None:
    code, document, said = mapped(
        capsys,
        "sep=;\nZeit;Längengrad;Breitengrad;Ertrag;Arbeitsbreite\n[s];[deg];[deg];[t/ha];[ft]",
        lambda at: f"{PLACE.format(at).replace(',', ';')};{YIELD_KG_M2 * 10};{WIDTH_M / FOOT_M}".replace(".", ","),
    )
    assert code == 0, said
    assert document["sources"][0]["skipped"] == []
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.035)


def test_words_for_a_header_that_is_up(capsys: pytest.CaptureFixture[str]) -> None:
    code, document, said = mapped(
        capsys,
        f"{HEAD},flow (kg/s),width (m),header",
        lambda at: f"{PLACE.format(at)},{FLOW_KG_S},6,{'Header Up' if at.second >= SECONDS - PASS_S else 'Header Down'}",
    )
    assert code == 0, said
    assert document["points_by_reason"]["header up"] == PASS_S


def test_dried_grain_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    _, _, said = mapped(capsys, f"{HEAD},dry yield (t/ha),width (m)", lambda at: f"{PLACE.format(at)},7,6")
    assert "dry yield (t/ha) is of dried grain: so are the masses" in said


@pytest.mark.parametrize(
    "names",
    [
        "Data,Ora,Longitudine,Latitudine,Resa (t/ha),Umidità (%),Larghezza di taglio (m),Velocità (km/h)",
        "Data,Czas,Długość geograficzna,Szerokość geograficzna,Plon (t/ha),Wilgotność (%),Szerokość robocza (m),Prędkość (km/h)",
        "Datum,Tijd,Lengtegraad,Breedtegraad,Opbrengst (t/ha),Vocht (%),Werkbreedte (m),Snelheid (km/h)",
        "Dato,Tid,Længdegrad,Breddegrad,Udbytte (t/ha),Vandindhold (%),Arbejdsbredde (m),Hastighed (km/t)",
        "Datum,Tid,Longitud,Latitud,Skörd (t/ha),Vattenhalt (%),Arbetsbredd (m),Hastighet (km/h)",
        "Dato,Tid,Lengdegrad,Breddegrad,Avling (t/ha),Vanninnhold (%),Arbeidsbredde (m),Hastighet (km/t)",
    ],
    ids=["Italian", "Polish", "Dutch", "Danish", "Swedish", "Norwegian"],
)
def test_names_in_further_languages(names: str, capsys: pytest.CaptureFixture[str]) -> None:
    def row(at: Point) -> str:
        clock = f"10:{at.second // 60:02d}:{at.second % 60:02d}"
        return f"2024-08-15,{clock},{at.longitude:.8f},{at.latitude:.8f},{YIELD_KG_M2 * 10},15.5,{WIDTH_M},{SPEED_M_S * 3.6}"

    code, document, said = mapped(capsys, names, row)
    assert code == 0, said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert document["area_ha"] * 1e4 == pytest.approx(MASS_KG / YIELD_KG_M2, rel=0.02)


def test_a_width_that_is_given_needs_no_unit_in_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    head, row = f"{HEAD},flow (kg/s),Swath Width", lambda at: f"{PLACE.format(at)},{FLOW_KG_S},3"
    assert mapped(capsys, head, row)[0] == 2
    code, document, said = mapped(capsys, head, row, "--width", str(WIDTH_M))
    assert code == 0, said
    assert "Swath Width has no unit and is not used" in said
    assert document["area_ha"] * 1e4 == pytest.approx(MASS_KG / YIELD_KG_M2, rel=0.03)


def test_places_far_from_the_field_are_no_way(capsys: pytest.CaptureFixture[str]) -> None:
    """Five rows of each 40 have one place that stands for "not known"; the yield is by area."""

    def row(at: Point) -> str:
        place = "0.0000001,0.0000001" if at.second % 40 < 5 else f"{at.longitude:.8f},{at.latitude:.8f}"
        return f"{at.second},{place},{YIELD_KG_M2 * 10},{WIDTH_M}"

    code, document, said = mapped(capsys, f"{HEAD},yield (t/ha),width (m)", row)
    assert code == 0, said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.03)


@pytest.mark.parametrize("time", ["2024-08-15T13:05:00Z", "2024-08-14T22:00:00Z", "2024-08-15", "0", "13:05:00"])
def test_a_time_that_stands_still_is_none(time: str, capsys: pytest.CaptureFixture[str]) -> None:
    """As of a file's export, or of the day's begin in another zone."""
    code, document, said = mapped(
        capsys,
        "time,longitude,latitude,flow (kg/s),width (m)",
        lambda at: f"{time},{at.longitude:.8f},{at.latitude:.8f},{FLOW_KG_S},6",
    )
    assert code == 0, said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert "rows are taken as one second apart" in said


def test_bars_between_columns(capsys: pytest.CaptureFixture[str]) -> None:
    code, document, said = mapped(
        capsys,
        f"{HEAD}|flow (kg/s)|width (m)".replace(",", "|"),
        lambda at: f"{PLACE.format(at)}|{FLOW_KG_S}|6".replace(",", "|"),
    )
    assert code == 0, said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)


def test_no_field_is_at_the_pole(capsys: pytest.CaptureFixture[str]) -> None:
    """Every fourth row has one place that stands for "not known"."""

    def row(at: Point) -> str:
        place = "180,90" if at.second % 4 == 0 else f"{at.longitude:.8f},{at.latitude:.8f}"
        return f"{at.second},{place},{FLOW_KG_S},{WIDTH_M}"

    code, document, said = mapped(capsys, f"{HEAD},flow (kg/s),width (m)", row)
    assert code == 0, said
    assert "latitude_deg outside -85 to 85 are taken as unknown" in said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)


def sexagesimal(degrees: float, letters: str) -> str:
    seconds = abs(degrees) % 1 * 3600
    return f"{int(abs(degrees))}°{int(seconds // 60)}'{seconds % 60:.4f}\"{letters[degrees < 0]}"


PLACES: dict[str, Callable[[float, float], str]] = {
    "letters": lambda x, y: f"{abs(x):.8f}{'EW'[x < 0]},{'NS'[y < 0]} {abs(y):.8f}",
    "minutes": lambda x, y: (
        f"{int(abs(x))}°{abs(x) % 1 * 60:.6f}'{'EW'[x < 0]},{int(abs(y))}° {abs(y) % 1 * 60:.6f}' {'NS'[y < 0]}"
    ),
    "seconds": lambda x, y: f"{sexagesimal(x, 'EW')},{sexagesimal(y, 'NS')}",
    "well-known text": lambda x, y: f"POINT ({x:.8f} {y:.8f}),",
    "well-known text with a height": lambda x, y: f"SRID=4326;POINT Z ({x:.8f} {y:.8f} 61.2),",
}


@pytest.mark.parametrize("sign", [1, -1], ids=["north east", "south west"])
@pytest.mark.parametrize("form", PLACES)
def test_places_as_texts(form: str, sign: int, capsys: pytest.CaptureFixture[str]) -> None:
    names = "WKT," if "text" in form else "longitude,latitude"
    code, document, said = mapped(
        capsys,
        f"time (s),{names},flow (kg/s),width (m)",
        lambda at: f"{at.second},{PLACES[form](float(sign * at.longitude), float(sign * at.latitude))},{FLOW_KG_S},{WIDTH_M}",
    )
    assert code == 0, said
    assert document["sources"][0]["points"] == SECONDS
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.001)
    assert document["area_ha"] * 1e4 == pytest.approx(MASS_KG / YIELD_KG_M2, rel=0.03)
