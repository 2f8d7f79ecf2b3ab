"""A harvest that a folder, a file or a command holds twice counts once."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

SECONDS, FLOW_KG_S, WIDTH_M = 600, 10.0, 6.0
MASS_KG = SECONDS * FLOW_KG_S


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def points(first: int = 0, last: int = SECONDS) -> geopandas.GeoDataFrame:
    second = np.arange(first, last)
    lane, along = second // 100, second % 100
    way_m = 1.5 * np.where(lane % 2 == 0, along, 100 - along)
    east = 8.0 + way_m / (EARTH_M_DEG * np.cos(np.radians(51.0)))
    places = geopandas.points_from_xy(east, 51.0 + WIDTH_M * lane / EARTH_M_DEG, crs=4326)
    columns = {"time": 1.7e9 + second, "flow_kg_s": FLOW_KG_S, "width_m": WIDTH_M, "speed_m_s": 1.5}
    return geopandas.GeoDataFrame(columns, geometry=places, index=second)


def as_csv(path: str, of: geopandas.GeoDataFrame) -> None:
    of.assign(longitude=of.geometry.x.round(7), latitude=of.geometry.y.round(7)).drop(columns="geometry").to_csv(
        path, index=False
    )


def mapped(capsys: pytest.CaptureFixture[str], *sources: str) -> tuple[dict[str, Any], str]:
    assert cli.main(["map", *sources, "--out", "unused", "--products", "none", "--json"]) == 0
    said = capsys.readouterr()
    return json.loads(said.out), said.err


def mass_kg(document: dict[str, Any]) -> float:
    return float(document["mass_kg"]["integrated"])


def test_a_folder_with_a_copy(capsys: pytest.CaptureFixture[str]) -> None:
    Path("folder").mkdir()
    as_csv("folder/a.csv", points())
    shutil.copy("folder/a.csv", "folder/copy of a.csv")
    document, said = mapped(capsys, "folder")
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.003)
    assert "600 rows also in folder: a.csv: the same harvest counts once" in said


def test_one_harvest_in_two_formats(capsys: pytest.CaptureFixture[str]) -> None:
    as_csv("a.csv", points())
    points().to_crs(32632).to_file("a.gpkg")
    document, _ = mapped(capsys, "a.csv", "a.gpkg")
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.003)
    assert "duplicate" not in document["points_by_reason"]


@pytest.mark.parametrize("order", [("day.csv", "week.csv"), ("week.csv", "day.csv")])
def test_a_day_s_file_beside_that_of_the_week(order: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    as_csv("day.csv", points(100, 300))
    as_csv("week.csv", points())
    document, _ = mapped(capsys, *order)
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.003)


def test_two_parts_of_a_harvest_are_no_copies(capsys: pytest.CaptureFixture[str]) -> None:
    as_csv("a.csv", points(0, 300))
    as_csv("b.csv", points(300))
    document, said = mapped(capsys, "a.csv", "b.csv")
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.003)
    assert "counts once" not in said


def test_all_layers_of_points_are_read(capsys: pytest.CaptureFixture[str]) -> None:
    points(0, 300).to_file("a.gpkg", layer="monday")
    points(300).to_file("a.gpkg", layer="tuesday")
    points(200, 350).to_file("a.gpkg", layer="both")
    points(0, 5)[["geometry"]].to_file("a.gpkg", layer="stones")
    document, said = mapped(capsys, "a.gpkg")
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.003)
    assert "a.gpkg: layer stones" in said


def test_numbers_that_a_file_has_as_texts(capsys: pytest.CaptureFixture[str]) -> None:
    texts = points().assign(flow_kg_s="10,0", width_m="6,0")
    texts.loc[::10, "flow_kg_s"] = "err"
    texts.to_file("a.geojson")
    document, said = mapped(capsys, "a.geojson")
    assert mass_kg(document) == pytest.approx(0.9 * MASS_KG, rel=0.003)
    assert "flow_kg_s holds no number in 60 of 600 rows, such as 'err'" in said


def test_a_raw_value_that_means_none_is_no_flow(capsys: pytest.CaptureFixture[str]) -> None:
    strange = points()
    strange.loc[::10, "flow_kg_s"] = 655.35
    as_csv("a.csv", strange)
    document, said = mapped(capsys, "a.csv")
    assert mass_kg(document) == pytest.approx(0.9 * MASS_KG, rel=0.003)
    assert "60 values of flow_kg_s outside 0 to 300 are taken as unknown" in said


def test_what_the_map_wrote_is_one_harvest_again(capsys: pytest.CaptureFixture[str]) -> None:
    as_csv("a.csv", points())
    assert cli.main(["map", "a.csv", "--out", "written"]) == 0
    capsys.readouterr()
    document, _ = mapped(capsys, "written")
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.003)
