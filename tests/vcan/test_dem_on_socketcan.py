"""A discrete-element combine measured over real SocketCAN: a campaign's force histories as sensor frames."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.vcan.nodes import Command, candump, daemon, eventually, read_back
from yieldmon import frames
from yieldmon.cli.main import main

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
FRICTION = 0.3
EMPTY_S = 10
#: Seconds of each flow, kg/s.
FLOWS = ((15, 12.0), (15, 6.0), (15, 9.0))
#: Seconds after a change of flow whose windows hold both.
CHANGE_S = 4.0
#: Of a window, and of the mean over a flow's windows.
WINDOW_TOLERANCE, MEAN_TOLERANCE = 0.15, 0.04


def calibrated(folder: Path) -> Path:
    """Parameters from the campaign's throws at one angle and speed."""
    with (DATA / "dem_campaign.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    crop, parameters = folder / "crop.csv", folder / "p.yaml"
    with crop.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["plate_angle_deg", "paddle_mass_kg", "elevator_speed_rpm", "momentum_kg_m_s"])
        writer.writerows(
            [r["plate_angle_deg"], r["paddle_mass_kg"], r["elevator_speed_rpm"], r["momentum_total_kg_m_s"]]
            for r in rows
            if (r["plate_angle_deg"], r["elevator_speed_rpm"], float(r["friction"])) == ("70", "400", FRICTION)
        )
    fixed = ["--fix", "shape_ratio=2", "--fix", f"friction={FRICTION}", "--fix", "density=700"]
    assert main(["calibrate", str(crop), "--out", str(parameters), "--impact", "exchange", *fixed]) == 0
    return parameters


def recorded(folder: Path) -> Path:
    """The combine whose paddles throw the campaign's pulses, as a log."""
    pieces = [{"kind": "steady", "duration_s": EMPTY_S, "flow_kg_s": 0}]
    pieces += [{"kind": "steady", "duration_s": span_s, "flow_kg_s": flow} for span_s, flow in FLOWS]
    duration_s = EMPTY_S + sum(span_s for span_s, _ in FLOWS)
    scenario, log = folder / "flow.yaml", folder / "combine.log"
    scenario.write_text(yaml.safe_dump({"duration_s": duration_s, "flow": {"variation_pct": 0, "pieces": pieces}}))
    words = ["-m", "studies.dem", "combine", str(DATA / "dem_campaign_forces.csv.gz"), "--friction", str(FRICTION)]
    command = [sys.executable, *words, "--scenario", str(scenario), "--log", str(log)]
    subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
    return log


def test_the_daemon_measures_a_discrete_element_combine(vcan0: str, tmp_path: Path, record_property) -> None:
    parameters, log = calibrated(tmp_path), recorded(tmp_path)
    recording = tmp_path / "seen.log"
    sections = f"parameter_file: {parameters}\nsweep: {{enabled: false}}\n"
    with daemon(vcan0, tmp_path, sections) as node, candump(vcan0, recording):
        Command(["replay", str(log), "-i", "socketcan", "-c", vcan0], tmp_path / "replay.txt", {}).finished()
        last = node.windows
        eventually(lambda: node.windows > last, "the last window")
    with node.store() as store:
        rows = store.seconds()
    assert sum(row.lost_frames + row.surplus_frames + row.repeated_frames for row in rows) == 0
    first_s = next(f.time_s for f in read_back(recording) if f.message in frames.INPUTS)
    start_s, errors = first_s + EMPTY_S, []
    for span_s, flow in FLOWS:
        inside = [r.mass_flow_kg_s for r in rows if start_s + CHANGE_S <= r.time_s <= start_s + span_s - 1.0]
        start_s += span_s
        assert len(inside) >= span_s - CHANGE_S - 2.0
        assert inside == pytest.approx([flow] * len(inside), rel=WINDOW_TOLERANCE)
        errors.append(sum(inside) / len(inside) / flow - 1.0)
    record_property("error_of_means_pct", [round(100.0 * error, 2) for error in errors])
    assert max(map(abs, errors)) < MEAN_TOLERANCE
