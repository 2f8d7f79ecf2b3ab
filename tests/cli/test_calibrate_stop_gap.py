"""`calibrate --stop-gap`: what is written, and what does not go with it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.in_process import program
from yieldmon.files import parameter_file
from yieldmon.physics.machine import Machine

SEED = 60118


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Readings that no grain gives."""
    noise = np.random.default_rng(SEED).standard_normal(1000)
    lines = ["plate_angle_deg,mass_flow_kg_s,elevator_speed_rpm,force_n,sigma"]
    for number, (angle, flow) in enumerate((a, q) for a in (50, 60, 70, 80, 90) for q in (3, 6, 10, 14, 18)):
        force = (6.0 * flow + 0.08 * flow**2) * (1.0 - 0.2 * np.cos(np.radians(angle)))
        lines.append(f"{angle},{flow},400,{force * (1.0 + 0.005 * noise[number]):.4f},{0.005 * force:.4f}")
    path = tmp_path / "rows.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_the_file_holds_the_stop_gap_and_the_report_says_so(table: Path, tmp_path: Path) -> None:
    out = tmp_path / "p.yaml"
    options = ("--effects", "gravity", "--impact", "restitution", "--starts", 2, "--out", out)
    done = program("yieldmon.cli.main", "calibrate", table, *options, "--stop-gap")
    assert done.returncode == 0, done.stderr
    assert "- stop-gap: beside likely grain" in done.stdout
    assert "stop_gap.w00" not in done.stdout
    found = parameter_file.load(out)
    assert found.effects == ("gravity", "stop_gap")
    assert found.values["stop_gap.highest_angle_deg"] == pytest.approx(90.0)
    assert found.provenance["stop_gap"]
    at = ("--mass-flow", 10, "--plate-angle", 70, "--elevator-speed", 400, "--json")
    predicted = program("yieldmon.cli.main", "predict", "--params", out, *at)
    assert json.loads(predicted.stdout)["rows"][0]["force_n"] == pytest.approx(
        68.0 * (1.0 - 0.2 * np.cos(np.radians(70))), rel=0.02
    )


@pytest.mark.parametrize("other", [("--robust",), ("--by-moisture",), ("--prior", "p.yaml")])
def test_what_does_not_go_with_it_is_refused_before_anything_is_read(other: tuple[str, ...]) -> None:
    done = program("yieldmon.cli.main", "calibrate", "absent.csv", "--stop-gap", *other)
    assert done.returncode == 2
    assert f"{other[0]}: cannot be combined with --stop-gap" in done.stderr


def test_rows_without_noise_are_refused(table: Path, tmp_path: Path) -> None:
    rows = [line.rpartition(",")[0] for line in table.read_text(encoding="utf-8").splitlines()]
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join(rows) + "\n", encoding="utf-8")
    done = program("yieldmon.cli.main", "calibrate", bare, "--impact", "restitution", "--starts", 1, "--stop-gap")
    assert done.returncode == 2
    assert "--stop-gap: a stop-gap needs the rows' noise: a sigma column" in done.stderr


def test_the_published_table_takes_one_although_its_own_fit_leaves_one_plus_e(tmp_path: Path) -> None:
    published, out = Path(__file__).parents[1] / "data/dem_table.csv", tmp_path / "p.yaml"
    done = program("yieldmon.cli.main", "calibrate", published, "--starts", 1, "--stop-gap", "--out", out)
    assert done.returncode == 0, done.stderr
    values = parameter_file.load(out).values
    assert 0.0 <= values["restitution"] <= 1.0
    rows, machine = np.genfromtxt(published, delimiter=",", names=True), Machine()
    per_s = float(machine.passes_per_s(machine.nominal_elevator_speed_rad_s))
    for angle, mass in ((50.0, 0.6), (70.0, 1.0), (90.0, 1.4)):
        here = (rows["plate_angle_deg"] == angle) & (rows["paddle_mass_kg"] == mass)
        words = ("--params", out, "--plate-angle", angle, "--mass-flow", mass * per_s, "--json")
        predicted = program("yieldmon.cli.main", "predict", *words)
        assert predicted.returncode == 0, predicted.stderr
        momentum = json.loads(predicted.stdout)["rows"][0]["paddle_momentum_kg_m_s"]
        assert momentum == pytest.approx(rows["momentum_kg_m_s"][here].mean(), rel=0.05)


def test_a_response_without_a_scale_takes_none_and_says_what_to_give() -> None:
    published = Path(__file__).parents[1] / "data/bench_table.csv"
    done = program("yieldmon.cli.main", "calibrate", published, "--starts", 1, "--stop-gap")
    assert done.returncode == 2
    assert "of a `response`: --response-scale S" in done.stderr
