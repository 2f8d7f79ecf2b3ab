"""self-calibrate on tables of several speeds, of loads of the paddle, and with cells that are not known."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from yieldmon.cli.main import main
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MODEL = ForwardModel(Machine())
GRAIN = {"friction": 0.3, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.4}
COVARIANCE = "covariance:\n  names: [friction, restitution]\n  matrix: [[0.0009, 0], [0, 0.0025]]\n"
ANGLES = (40.0, 55.0, 70.0, 90.0)
NOISE = 0.1
"""kg m/s a paddle"""

Rows = list[dict[str, str]]


def rows(speeds: Sequence[float], loads: Sequence[float], load: str) -> Rows:
    """Two readings at each angle, speed and load, with noise."""
    noise, out = np.random.default_rng(5), []
    for speed in speeds:
        for value in loads:
            at = Conditions(np.radians(ANGLES), speed * RPM, **{load: value})
            for angle, momentum in zip(ANGLES, MODEL.paddle_momentum(at, GRAIN), strict=True):
                for scatter in noise.normal(0.0, NOISE, 2):
                    row = (angle, speed, value, momentum + scatter)
                    names = ("plate_angle_deg", "elevator_speed_rpm", load, "momentum_kg_m_s")
                    out.append({name: repr(float(cell)) for name, cell in zip(names, row, strict=True)})
    return out


def table(tmp_path: Path, cells: Rows) -> list[str]:
    """The words of the command for a table of these rows."""
    path, known = tmp_path / "sweeps.csv", tmp_path / "known.yaml"
    path.write_text("\n".join([",".join(cells[0]), *(",".join(row.values()) for row in cells)]) + "\n")
    known.write_text("".join(f"{name}: {value}\n" for name, value in GRAIN.items()) + COVARIANCE)
    return ["self-calibrate", str(path), "--params", str(known), "--json"]


def found(capsys: pytest.CaptureFixture[str], words: list[str]) -> dict:
    assert main(words) == 0
    return json.loads(capsys.readouterr().out)


def test_readings_at_another_speed_are_no_repeats(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    update = found(capsys, table(tmp_path, rows((350.0, 450.0), (6.0, 15.0), "mass_flow_kg_s")))["updates"][0]
    assert update["dof"] / 3.0 < update["chi2"] < 3.0 * update["dof"]


def test_a_load_of_the_paddle_is_another_flow_at_each_speed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    groups = found(capsys, table(tmp_path, rows((350.0, 450.0), (0.4, 1.2), "paddle_mass_kg")))["groups"]
    assert [g["group"] for g in groups] == ["0.4 at 350 rpm", "1.2 at 350 rpm", "0.4 at 450 rpm", "1.2 at 450 rpm"]
    for group in groups:
        load, speed = float(group["group"].split()[0]), float(group["group"].split()[2])
        assert group["true_mass_flow_kg_s"] == pytest.approx(load * Machine().passes_per_s(speed * RPM))
        assert abs(group["mass_flow_kg_s"] - group["true_mass_flow_kg_s"]) < 4.0 * group["std_dev_kg_s"]


def test_a_load_at_one_speed_keeps_its_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    groups = found(capsys, table(tmp_path, rows((400.0,), (0.4, 1.2), "paddle_mass_kg")))["groups"]
    assert [g["group"] for g in groups] == ["0.4", "1.2"]


def test_rows_of_an_unknown_group_are_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cells = rows((400.0,), (6.0, 15.0), "mass_flow_kg_s")
    whole = found(capsys, table(tmp_path, cells[1:]))
    cells[0]["mass_flow_kg_s"] = "-"
    assert main(table(tmp_path, cells)) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["groups"] == whole["groups"]
    assert err.endswith("sweeps.csv: 1 row without mass_flow_kg_s is left out (line 2)\n")


def test_loads_of_which_none_is_known_are_one_sweep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cells = [row | {"mass_flow_kg_s": "nan"} for row in rows((400.0,), (6.0,), "mass_flow_kg_s")]
    assert [g["group"] for g in found(capsys, table(tmp_path, cells))["groups"]] == ["all rows"]


def test_a_noise_that_is_stated_for_some_rows_counts_for_these(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cells = rows((400.0,), (6.0, 15.0), "mass_flow_kg_s")
    unstated = found(capsys, table(tmp_path, [row | {"sigma": "-"} for row in cells]))["groups"]
    precise = [row | {"sigma": "0.05" if row["mass_flow_kg_s"] == "6.0" else "-"} for row in cells]
    partly = found(capsys, table(tmp_path, precise))["groups"]
    assert partly[0]["std_dev_kg_s"] < unstated[0]["std_dev_kg_s"]
    assert main([*table(tmp_path, [row | {"sigma": "0"} for row in cells]), "--sigma", "1"]) == 2
    assert "column sigma has zeros; expected a number above 0" in capsys.readouterr().err


def test_parameters_without_a_covariance_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = table(tmp_path, rows((400.0,), (6.0,), "mass_flow_kg_s"))
    known = Path(words[3])
    known.write_text(known.read_text().replace(COVARIANCE, ""))
    assert main(words) == 2
    assert capsys.readouterr().err.startswith(f"yieldmon: {known}: has no covariance")


HEADER = "plate_angle_deg,group,force_n,sigma"
REFUSED = {
    "an empty machine": (
        [(40, 0.1, 0.5), (60, -0.2, 0.5), (80, 0.05, 0.5)],
        "sweep 1 of 1: its forces are those of an empty machine",
    ),
    "noise of next to nothing": (
        [(40, 50, 1e-9), (60, 75, 1), (80, 80, 1)],
        "group a: sweep: force_std_dev_n must be at least 1e-09",
    ),
    "copies, whose scatter is rounding": (
        [(angle, force, "") for angle, force in ((40, 24.3), (60, 67.2), (80, 109.8)) for _ in range(9)],
        "holds repeated rows without any scatter; expected --sigma SD",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_sweeps_that_hold_no_flow_or_no_noise_are_refused(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    readings, message = REFUSED[case]
    path = tmp_path / "sweep.csv"
    path.write_text("\n".join([HEADER, *(f"{angle},a,{force},{sigma}" for angle, force, sigma in readings)]) + "\n")
    assert main(["self-calibrate", str(path)]) == 2
    assert message in capsys.readouterr().err


def test_rows_that_are_copies_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cells = rows((400.0,), (12.0,), "mass_flow_kg_s")
    for copies, named in ((1, False), (3, True)):
        assert main([*table(tmp_path, cells * copies), "--sigma", "0.1"]) == 0
        assert ("24 of 24 rows repeat another reading of the same condition" in capsys.readouterr().err) is named
