"""Notes about what a command reads: one line each when it has worked, none where it was refused."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from yieldmon.cli.main import main
from yieldmon.resources import shipped

UNENDED = "model_error: 0\nfriction: 0.3\ndensity: 1100\nshape_ratio: 2\nrestitution: 0.4"
"""A file without the end of its last line."""


@pytest.fixture
def params(tmp_path: Path) -> Path:
    path = tmp_path / "grain.yaml"
    path.write_text(UNENDED)
    return path


def test_a_note_of_a_file_that_serves_comes_once(params: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["predict", "--mass-flow", "5", "--params", str(params)]) == 0
    out, err = capsys.readouterr()
    assert out.count("\n") == 2
    assert err == f"yieldmon: {params}: its last line has no end; a file that was cut off ends like that\n"


@pytest.mark.parametrize(
    ("text", "flow", "problem"),
    [
        (UNENDED, "500", "predict: load of 41.1163 kg a paddle"),
        (UNENDED.replace("1100", "-5"), "5", "density: is -5"),
        (UNENDED.replace("0.4", "four"), "5", "restitution: is 'four'"),
    ],
)
def test_a_refusal_is_one_line(params: Path, capsys: pytest.CaptureFixture[str], text: str, flow: str, problem: str) -> None:
    params.write_text(text)
    assert main(["predict", "--mass-flow", flow, "--params", str(params)]) == 2
    err = capsys.readouterr().err
    assert problem in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("verb", ["calibrate", "diagnose", "estimate", "self-calibrate"])
def test_a_table_with_columns_of_its_own_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    table = tmp_path / "table.csv"
    table.write_text("plate_angle_deg,mass_flow_kg_s,momentum_kg_m_s,plot\n70,5,3.5,a\n70,,3.5,b\n")
    known = tmp_path / "response.yaml"
    known.write_text(f"{UNENDED.replace('restitution: 0.4', 'k1: 1')}\nk2: 30\nresponse_unit: response\n")
    words = ["--params", str(known)] if verb == "estimate" else []
    assert main([verb, str(table), *words]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("verb", [["run", "--config"], ["check-config"]])
def test_a_configuration_whose_machine_file_has_no_end_is_refused_in_one_line(
    tmp_path: Path, params: Path, verb: list[str]
) -> None:
    params.write_text(UNENDED.replace("0.3", "9"))
    config, machine = tmp_path / "c.yaml", tmp_path / "m.yaml"
    machine.write_text(shipped("config/machines/sprocket-8.yaml").read_text().rstrip())
    config.write_text(f"machine_file: {machine}\nparameter_file: {params}\n")
    # A process of its own: the daemon sets signals, and what nobody takes is printed where no test listens.
    words = [sys.executable, "-m", "yieldmon", *verb, str(config)]
    done = subprocess.run(words, check=False, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "friction: is 9" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        ["pack", "cut.log", "--out", "cut.parquet"],
        ["monitor", "cut.log", "--once"],
        ["signals", "cut.log"],
    ],
    ids=lambda words: words[0],
)
def test_a_damaged_place_of_a_log_is_said_once(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("cut.log").write_text("(0.0) can0 123#00\n(1.0) can")
    main(words)
    lines = [line for line in capsys.readouterr().err.splitlines() if "candump" in line]
    assert lines == ["yieldmon: cut.log:2: '(1.0) can' is not a candump line"]
