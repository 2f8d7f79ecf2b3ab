"""Area, yield and both systems of units where people read them: a simulated harvest through `process`, a daemon's answers."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
import yaml

from yieldmon.cli.main import main
from yieldmon.files import machine_file

WIDTH_M, SPEED_KM_H, FLOW_KG_S, HARVEST_S = 9.0, 7.2, 12.0, 40
SCENARIO = {
    "duration_s": 60,
    "field": {"ground_speed_km_h": SPEED_KM_H, "swath_m": WIDTH_M},
    "flow": {
        "variation_pct": 0.0,
        "pieces": [
            {"kind": "steady", "duration_s": 8, "flow_kg_s": 0},
            {"kind": "steady", "duration_s": HARVEST_S, "flow_kg_s": FLOW_KG_S},
            {"kind": "steady", "duration_s": 12, "flow_kg_s": 0},
        ],
    },
    "frames": {"grain_condition": True, "position": True, "harvest_state": True},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log, and a configuration with a header 9 m wide whose grain takes no time."""
    folder = tmp_path_factory.mktemp("units")
    (folder / "s.yaml").write_text(yaml.safe_dump(SCENARIO))
    document = machine_file.to_document(machine_file.load())
    (folder / "machine.yaml").write_text(yaml.safe_dump(document | {"implement": {"working_width_m": WIDTH_M}}))
    (folder / "us.yaml").write_text("machine_file: machine.yaml\nunits: us\n")
    made = ["simulate", "--scenario", str(folder / "s.yaml"), "--seed", "3", "--log", str(folder / "d.log")]
    assert main([*made, "--truth", str(folder / "t.csv")]) == 0
    return folder


def process(folder: Path, *options: str) -> int:
    table = ["--out", str(folder / "d.csv"), "--force", "--jobs", "1"]
    return main(["process", str(folder / "d.log"), "--config", str(folder / "us.yaml"), *table, *options])


def test_process_knows_area_and_yield(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert process(folder, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["area_m2"] == pytest.approx(WIDTH_M * SPEED_KM_H / 3.6 * HARVEST_S, rel=0.06)
    assert found["mass_of_unknown_area_kg"] == 0.0
    with (folder / "d.csv").open(newline="") as table:
        last = list(csv.DictReader(table))[-1]
    assert found["total_std_dev_kg"] == pytest.approx(float(last["total_std_dev_kg"])) != 0.0
    assert found["yield_kg_m2"] == pytest.approx(found["total_mass_kg"] / found["area_m2"])
    assert found["yield_kg_m2"] == pytest.approx(FLOW_KG_S / (WIDTH_M * SPEED_KM_H / 3.6), rel=0.1)


@pytest.mark.parametrize(
    ("options", "units"),
    [
        ([], (" lb ± ", " lb (", " ac, ", " lb/ac")),
        (["--units", "metric"], (" kg ± ", " kg (", " ha, ", " t/ha")),
    ],
)
def test_process_says_it_in_the_units_asked_for(
    folder: Path, options: list[str], units: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert process(folder, *options) == 0
    said = capsys.readouterr().err
    assert all(unit in said for unit in units), said
