"""Task data that is written of several machines and fields."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import pytest

from yieldmon.cli import main as cli

from .test_rows_of_strangers import AREA_M2, MASS_KG, PASS_S, home, rows, text  # noqa: F401


def test_each_machine_s_fields_are_tasks_of_their_own(capsys: pytest.CaptureFixture[str]) -> None:
    """All of a machine's harvest was in its first field, and fields had the mean of their areas."""
    table = [row | {"machine": "A", "field": "north"} for row in rows()]
    table += [row | {"machine": "B", "field": "south"} for row in rows(longitude=11.01)]
    table += [row | {"machine": "A", "field": "west"} for row in rows(start_s=1.7e9 + 5000, longitude=11.02)[: 4 * PASS_S]]
    Path("h.csv").write_text(text(table))
    words = ["--flow-delay", "0", "--json"]
    assert cli.main(["map", "h.csv", "--out", "out", "--products", "taskdata", *words]) == 0
    first = json.loads(capsys.readouterr().out)
    with zipfile.ZipFile("out/taskdata.zip") as archive:
        root = ET.fromstring(archive.read("TASKDATA/TASKDATA.XML"))
    fields = {one.attrib["A"]: (one.attrib["C"], float(one.attrib["D"])) for one in root.iter("PFD")}
    assert sorted(name for name, _ in fields.values()) == ["north", "south", "west"]
    for name, area_m2 in fields.values():
        assert area_m2 == pytest.approx(AREA_M2 * (0.5 if name == "west" else 1.0), rel=0.02)
    mass_kg = {
        fields[task.attrib["E"]][0]: float(value.attrib["B"])
        for task in root.iter("TSK")
        for value in task.iter("DLV")
        if value.attrib["A"] == "005A"
    }
    assert mass_kg == pytest.approx({"north": MASS_KG, "south": MASS_KG, "west": MASS_KG / 2}, rel=0.02)
    assert cli.main(["map", "out/taskdata.zip", "--out", "again", "--products", "csv", *words]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["mass_kg"]["integrated"] == pytest.approx(first["mass_kg"]["integrated"], rel=1e-3)
    assert again["area_ha"] == pytest.approx(first["area_ha"], rel=1e-3)
    written = Path("again/points.csv").read_text()
    assert all(f",{name}," in written for name in ("north", "south", "west"))
