"""Shipped files by name, for whoever installed the package and has no checkout to point at; rows outside the calibration."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from yieldmon.api import shipped
from yieldmon.cli.main import main

TABLE = str(Path(__file__).parents[1] / "data" / "bench_table.csv")


@pytest.mark.parametrize(
    ("option", "name", "folder"),
    [("--params", "published-example", "parameters"), ("--machine", "sprocket-10", "machines")],
)
def test_a_shipped_name_is_its_file(option: str, name: str, folder: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = shipped(f"config/{folder}/{name}.yaml")
    printed = []
    for given in (name, str(path)):
        assert main(["predict", "--mass-flow", "3,9", option, given, "--json"]) == 0
        printed.append(json.loads(capsys.readouterr().out))
    assert printed[0] == printed[1]
    assert main(["predict", "--mass-flow", "3,9", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) != printed[0]


def test_a_file_of_the_same_name_goes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What lies in the folder is what its owner means."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "corn").write_text("nonsense\n", encoding="utf-8")
    assert main(["predict", "--mass-flow", "3", "--params", "corn"]) == 2


@pytest.mark.parametrize(
    ("command", "shown"),
    [
        (
            "predict --mass-flow 3 --params wheet",
            "--params: 'wheet' is neither a file nor shipped; expected a path, or one of corn,",
        ),
        (
            "predict --mass-flow 3 --machine x",
            "--machine: 'x' is neither a file nor shipped; expected a path, or one of sprocket-10",
        ),
        (f"diagnose {TABLE} --params wheet", "--params: 'wheet' is neither a file nor shipped"),
        (f"calibrate {TABLE} --prior wheet", "--prior: 'wheet' is neither a file nor shipped"),
        ("simulate --machine x --log never.log", "--machine: 'x' is neither a file nor shipped"),
    ],
)
def test_no_such_name(command: str, shown: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert shown in line


def test_a_shipped_prior_is_the_parent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "p.yaml"
    assert main(["calibrate", TABLE, "--prior", "published-example", "--starts", "2", "--out", str(out)]) == 0
    capsys.readouterr()
    assert "published-example.yaml sha256" in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--mass-flow 3,9,20", ""),
        ("--mass-flow 3,40", "1 of 2 rows lie outside the calibrated range: mass_flow_kg_s 0.3 to 26, plate_angle_deg 40 to 90"),
        ("--mass-flow 3 --plate-angle 70,90,95", "1 of 3 rows lie outside"),
        ("--mass-flow 3 --elevator-speed 300,400", "1 of 2 rows lie outside"),
    ],
)
def test_rows_outside_the_calibration_are_said(options: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    """As `estimate` gives such rows a status of their own."""
    assert main(["predict", *options.split(), "--params", "corn"]) == 0
    err = capsys.readouterr().err
    assert said in err
    assert bool(err) is bool(said)
