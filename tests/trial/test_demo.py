"""The demo verb: its document, its promise on a fixed seed, and that a seed decides everything."""

from __future__ import annotations

import json

import pytest

from yieldmon.cli.main import main
from yieldmon.resources import shipped


@pytest.fixture(scope="module")
def demo():
    def run(*options: str, capsys) -> dict:
        assert main(["demo", "--json", *options]) == 0
        return json.loads(capsys.readouterr().out)

    return run


def test_the_default_scenario_stays_within_the_stated_error(demo, capsys, tmp_path):
    picture = tmp_path / "demo.png"
    found = demo("--duration", "120", "--seed", "1", "--picture", str(picture), capsys=capsys)
    assert set(found) >= {"flow_error_pct", "mass_error_pct", "windows", "sweeps", "bands"}
    assert found["flow_error_pct"]["p95_abs"] <= 5.0
    assert abs(found["mass_error_pct"]) <= 1.0
    assert found["missing_rated_windows"] == 0
    assert sum(band["windows"] for band in found["bands"]) == found["windows"]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_seed_decides(demo, capsys):
    runs = [demo("--duration", "20", "--seed", seed, capsys=capsys) for seed in ("5", "5", "6")]
    assert runs[0] == runs[1] != runs[2]


def test_the_table_is_plain_text(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    assert main(["demo", "--duration", "20"]) == 0
    title, headings, *bands, flow, mass = capsys.readouterr().out.splitlines()
    assert title.startswith("measured against true flow, 1 Hz, 20 s, ")
    assert {len(line) for line in (headings, *bands)} == {len(headings)}
    assert bands[2].split()[0] == "4-8"
    assert flow.startswith("from 4 kg/s: mean |error| ")
    assert mass.startswith("accumulated: ")


def test_the_configured_machine_is_the_one_simulated(capsys, tmp_path):
    shipped_machine = shipped("config/machines/sprocket-8.yaml").read_text(encoding="utf-8")
    six = shipped_machine.replace("name: sprocket-8", "name: sprocket-6").replace("0.0541", "0.0406")
    (tmp_path / "six.yaml").write_text(six, encoding="utf-8")
    (tmp_path / "config.yaml").write_text("machine_file: six.yaml\n", encoding="utf-8")
    words = ["demo", "--duration", "20", "--config", str(tmp_path / "config.yaml")]
    assert main([*words, "--json"]) == 0
    six_teeth = json.loads(capsys.readouterr().out)
    assert main(["demo", "--duration", "20", "--json"]) == 0
    assert six_teeth["measured_mass_kg"] != json.loads(capsys.readouterr().out)["measured_mass_kg"]
    assert abs(six_teeth["mass_error_pct"]) < 5.0
    scenario = str(shipped("config/scenarios/demo.yaml"))
    assert main([*words, "--scenario", scenario]) == 2
    assert capsys.readouterr().err == f"yieldmon: {scenario}: machine is 'sprocket-8'; expected 'sprocket-6' as configured\n"


@pytest.mark.parametrize("picture", ["x.pdf", "x", "nowhere/x.png", "."])
def test_a_picture_that_cannot_be_written_is_reported_before_the_run(picture, capsys):
    assert main(["demo", "--picture", picture]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("yieldmon: ")
    assert err.count("\n") == 1


@pytest.mark.parametrize("duration", ["1", "1e9", "nan"])
def test_a_wrong_duration_is_one_line(duration, capsys):
    assert main(["demo", "--duration", duration]) == 2
    assert "--duration" in capsys.readouterr().err
