"""A harvest of several crops: each point's bushel, and task data with each crop."""

from __future__ import annotations

import csv
import json
import math
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path
from typing import Any

import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

BUSHEL_LB = {"corn": 56.0, "soybean": 60.0, "wheat": 60.0}
"""USDA test weights."""
KG_PER_LB, M2_PER_ACRE = 0.45359237, 4046.8564224
PASS_S, SPEED_M_S, WIDTH_M = 200, 2.0, 6.0


def harvest(path: Path, passes: list[tuple[str, str, float]]) -> None:
    """A pass of 400 m each, side by side: its field, crop and flow, kg/s."""
    rows = ["time(s),longitude,latitude,flow_kg_s,width_m,load,field,crop"]
    for number, (field, crop, flow) in enumerate(passes):
        for second in range(PASS_S):
            along = SPEED_M_S * (second if number % 2 == 0 else PASS_S - 1 - second)
            east = WIDTH_M * number / (EARTH_M_DEG * math.cos(math.radians(48.0)))
            rows.append(
                f"{1_760_000_000 + 300 * number + second},{east:.9f},{48.0 + along / EARTH_M_DEG:.9f},{flow},{WIDTH_M:g},"
                f"{number + 1},{field},{crop}"
            )
    path.write_text("\n".join(rows))


TWO = [("north", "corn", 12.0)] * 3 + [("north", "soybean", 5.0)] * 2 + [("south", "wheat", 8.0)] * 2


def mapped(folder: Path, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[dict[str, Any], str]:
    """The document of `map` and what it says beside."""
    told = ["map", str(folder / "h.csv"), "--out", str(folder / "map"), "--flow-delay", "0", "--json", *words]
    assert cli.main(told) == 0
    out, err = capsys.readouterr()
    return json.loads(out), err


def test_each_point_has_the_bushel_of_its_crop(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    harvest(tmp_path / "h.csv", TWO)
    found, _ = mapped(tmp_path, capsys, "--products", "csv")
    assert found["yield_bu_ac"] is None
    with (tmp_path / "map" / "points.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["kept"] == "1"]
    assert {row["crop"] for row in rows} == set(BUSHEL_LB)
    for row in rows:
        bushels = float(row["yield_t_ha"]) * 0.1 * M2_PER_ACRE / (BUSHEL_LB[row["crop"]] * KG_PER_LB)
        assert float(row["yield_bu_ac"]) == pytest.approx(bushels, rel=1e-4)


@pytest.mark.parametrize(
    ("passes", "said"),
    [
        (TWO, "the bushels of corn, soybean, wheat differ: yields are in lb/ac"),
        ([("n", "corn", 9.0), ("s", "chickpea", 4.0)], "the bushel of chickpea is not known: yields are in lb/ac"),
        ([("n", "", 9.0)], "the bushel of an unknown crop is not known: yields are in lb/ac"),
        ([("n", "soybean", 5.0), ("s", "wheat", 5.0)], ""),
        ([("n", "corn", 9.0), ("n", "", 9.0)], ""),
    ],
)
def test_yields_of_crops_with_unlike_bushels_are_in_pounds(
    passes: list[tuple[str, str, float]], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    harvest(tmp_path / "h.csv", passes)
    found, err = mapped(tmp_path, capsys, "--products", "report", "--units", "us")
    assert said in err
    assert ("lb/ac" in err.splitlines()[-1]) == bool(said)
    assert (found["yield_bu_ac"] is None) == bool(said)
    assert ('"unit":{"name":"lb/ac"' in (tmp_path / "map" / "report.html").read_text()) == bool(said)


@pytest.mark.parametrize(
    ("passes", "crop", "kg_s"),
    [
        (TWO, "", {"corn": 36.0, "wheat": 16.0, "soybean": 10.0}),
        ([("n", "corn", 9.0), ("n", "", 9.0)], "corn", {"corn": 18.0}),
        ([("n", "corn", 9.0), ("s", "", 4.0)], "", {"corn": 9.0, "": 4.0}),
        ([("n", "", 9.0)], "", {"": 9.0}),
    ],
)
def test_the_numbers_name_the_crop_of_all_grain_or_each(
    passes: list[tuple[str, str, float]], crop: str, kg_s: dict[str, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    harvest(tmp_path / "h.csv", passes)
    found, _ = mapped(tmp_path, capsys, "--products", "none")
    assert found["crop"] == crop
    assert {one["crop"]: one["mass_kg"] for one in found["crops"]} == pytest.approx(
        {name: rate * PASS_S for name, rate in kg_s.items()}, rel=0.02
    )
    assert sum(one["mass_kg"] for one in found["crops"]) == pytest.approx(found["mass_kg"]["integrated"], rel=1e-6)
    assert sum(one["kept_kg"] for one in found["crops"]) == pytest.approx(found["mass_kg"]["kept"], rel=1e-6)


def test_the_report_names_all_crops(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    harvest(tmp_path / "h.csv", TWO)
    mapped(tmp_path, capsys, "--products", "report")
    assert '"title":"north south, corn, soybean, wheat: yield map"' in (tmp_path / "map" / "report.html").read_text()


def test_task_data_has_a_task_for_each_crop_of_a_field(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    harvest(tmp_path / "h.csv", [*TWO, ("north", "", 2.0), ("south", "", 7.0)])
    mapped(tmp_path, capsys, "--products", "taskdata")
    with zipfile.ZipFile(tmp_path / "map" / "taskdata.zip") as archive:
        root = ET.fromstring(archive.read("TASKDATA/TASKDATA.XML"))
    crops = {one.attrib["A"]: one.attrib["B"] for one in root.iter("CTP")}
    fields = {one.attrib["A"]: (one.attrib["C"], crops.get(one.attrib.get("G", ""), "")) for one in root.iter("PFD")}
    assert all(one.attrib.get("G") != "" for one in root.iter("PFD"))
    mass_kg = {
        fields[task.attrib["E"]]: float(value.attrib["B"])
        for task in root.iter("TSK")
        for value in task.iter("DLV")
        if value.attrib["A"] == "005A"
    }
    # What names no crop is wheat in the south, where all that does is, and of no known crop in the north, which has two.
    expected = {("north", "corn"): 36.0, ("north", "soybean"): 10.0, ("south", "wheat"): 23.0, ("north", ""): 2.0}
    assert mass_kg == pytest.approx({place: kg_s * PASS_S for place, kg_s in expected.items()}, rel=0.02)
    Path(tmp_path / "h.csv").unlink()
    (tmp_path / "map" / "taskdata.zip").rename(tmp_path / "again.zip")
    words = ["map", str(tmp_path / "again.zip"), "--out", str(tmp_path / "again"), "--products", "csv", "--flow-delay", "0"]
    assert cli.main(words) == 0
    capsys.readouterr()
    with (tmp_path / "again" / "points.csv").open() as stream:
        assert {(row["field"], row["crop"]) for row in csv.DictReader(stream)} == set(expected)


def test_a_ticket_is_held_against_those_of_its_crop_and_scales_that_crop(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The monitor shows a tenth too much corn and a third too little soybean; its wheat is not weighed."""
    factor = {"corn": 0.9, "soybean": 1.5}
    flows = [("corn", 12.0)] * 5 + [("soybean", 5.0)] * 2 + [("wheat", 8.0)]
    harvest(tmp_path / "h.csv", [("north", crop, flow) for crop, flow in flows])
    rows = [f"{n},{factor[flows[n - 1][0]] * flows[n - 1][1] * PASS_S}" for n in (1, 2, 3, 4, 6)]
    (tmp_path / "t.csv").write_text("load,weighed_kg\n" + "\n".join(rows))
    found, _ = mapped(tmp_path, capsys, "--products", "none", "--tickets", str(tmp_path / "t.csv"))
    assert {int(load["load"]): load["factor"] for load in found["loads"]} == pytest.approx(
        {n: factor.get(crop, 1.0) for n, (crop, _) in enumerate(flows, 1)}, rel=2e-3
    )
    said = "as measured, for no weighed load is of the same crop and calibration: load 8"
    assert [note for note in found["notes"] if "ticket" in note or "weighed" in note] == [said]
    # How far the others are off: 0.1 four times, 0.5 once.
    off_kg = 8.0 * PASS_S * math.sqrt((4 * 0.1**2 + 0.5**2) / 5)
    mass = found["mass_kg"]
    assert mass["high"] - mass["corrected"] == pytest.approx(1.96 * off_kg, rel=0.1)


def test_a_ticket_for_loads_of_two_crops_scales_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    harvest(tmp_path / "h.csv", [("north", "corn", 10.0)] * 3 + [("north", "soybean", 5.0)] * 2)
    (tmp_path / "t.csv").write_text(f"load,weighed_kg\n1,{9.0 * PASS_S}\n3-4,{18.0 * PASS_S}\n")
    found, _ = mapped(tmp_path, capsys, "--products", "none", "--tickets", str(tmp_path / "t.csv"))
    factors = {int(load["load"]): load["factor"] for load in found["loads"]}
    assert factors == pytest.approx({1: 0.9, 2: 0.9, 3: 1.2, 4: 1.2, 5: 1.0}, rel=2e-3)
