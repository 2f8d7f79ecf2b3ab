"""A discrete-element combine through the codec, a log and the engine, calibrated at one angle and speed."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import yaml

from tests.in_process import program
from yieldmon.cli.main import main

ROOT = Path(__file__).parents[3]
DATA = ROOT / "tests" / "data"


@pytest.mark.parametrize("friction", [0.3, 0.15])
def test_the_monitor_weighs_grain(friction: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (DATA / "dem_campaign.csv").open(encoding="utf-8", newline="") as stream:
        rows = [r for r in csv.DictReader(stream) if float(r["friction"]) == friction]
    crop = tmp_path / "crop.csv"
    with crop.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["plate_angle_deg", "paddle_mass_kg", "elevator_speed_rpm", "momentum_kg_m_s"])
        writer.writerows(
            [r["plate_angle_deg"], r["paddle_mass_kg"], r["elevator_speed_rpm"], r["momentum_total_kg_m_s"]]
            for r in rows
            if r["plate_angle_deg"] == "70" and r["elevator_speed_rpm"] == "400"
        )
    parameters, configuration = tmp_path / "p.yaml", tmp_path / "y.yaml"
    fixed = ["--fix", "shape_ratio=2", "--fix", f"friction={friction}", "--fix", "density=700"]
    assert main(["calibrate", str(crop), "--out", str(parameters), "--impact", "exchange", *fixed]) == 0
    configuration.write_text(yaml.safe_dump({"parameter_file": str(parameters)}), encoding="utf-8")
    scenario = tmp_path / "flow.yaml"
    scenario.write_text(
        yaml.safe_dump(
            {
                "duration_s": 45,
                "flow": {
                    "variation_pct": 0,
                    "pieces": [
                        {"kind": "steady", "duration_s": 10, "flow_kg_s": 0},
                        {"kind": "steady", "duration_s": 15, "flow_kg_s": 12},
                        {"kind": "steady", "duration_s": 20, "flow_kg_s": 6},
                    ],
                },
            }
        ),
        encoding="utf-8",
    )
    log, out = tmp_path / "c.log", tmp_path / "out.csv"
    forces = DATA / "dem_campaign_forces.csv.gz"
    words = ("combine", forces, "--friction", friction, "--scenario", scenario, "--log", log)
    done = program("studies.dem.__main__", *words)
    assert done.returncode == 0, done.stderr
    assert main(["process", str(log), "--config", str(configuration), "--out", str(out)]) == 0
    capsys.readouterr()
    with out.open(encoding="utf-8", newline="") as stream:
        seen = list(csv.DictReader(stream))
    for second, flow in ((20, 12.0), (38, 6.0)):
        nearby = [float(r["mass_flow_kg_s"]) for r in seen if abs(float(r["time_s"]) - second) < 4.0]
        assert sum(nearby) / len(nearby) == pytest.approx(flow, rel=0.04)
