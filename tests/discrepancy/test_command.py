"""`yieldmon diagnose`: the document, adoption and its way back, the report, and errors of one line."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.golden import kept
from yieldmon.cli.main import main
from yieldmon.discrepancy import adoption, diagnosis, report
from yieldmon.discrepancy.observations import hold_out
from yieldmon.estimation.parameters import CARRIED, CARRIED_FROM, SCALE, ParameterSet
from yieldmon.files import parameter_file, table
from yieldmon.files.table import Table
from yieldmon.physics.machine import Machine

DATA = Path(__file__).resolve().parents[1] / "data"


@pytest.fixture(scope="module")
def offset_table(tmp_path_factory) -> Path:
    """A table with a zero offset of 4 N, from the generator."""
    from studies.hidden_effects import generator

    speed, flow, _, angle = (
        a.ravel()
        for a in np.meshgrid([41.9, 48.0], [2.0, 6.0, 14.0], [1, 2, 3], np.radians(np.arange(40.0, 91.0, 10.0)), indexing="ij")
    )
    force = generator.force(
        angle, speed, flow, np.full(angle.shape, 15.0), generator.Grain(0.3, 0.55, 1150.0), {"zero_offset": 4.0}
    )
    force = force * (1.0 + 0.01 * np.random.default_rng(4).standard_normal(force.shape))
    path = tmp_path_factory.mktemp("tables") / "offset.csv"
    rows = [
        f"{np.degrees(a):.6g},{q:.6g},{s / generator.RPM:.8g},{f:.8g}"
        for a, q, s, f in zip(angle, flow, speed, force, strict=True)
    ]
    path.write_text("plate_angle_deg,mass_flow_kg_s,elevator_speed_rpm,force_n\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def diagnoses() -> dict[str, diagnosis.Diagnosis]:
    return {}


@pytest.fixture
def diagnosed_once(diagnoses: dict[str, diagnosis.Diagnosis], monkeypatch: pytest.MonkeyPatch) -> None:
    """One diagnosis of the same table, parameters and options for all tests that are about what comes of it."""
    real = diagnosis.diagnose

    def once(table: Table, machine: Machine, known: ParameterSet, options: diagnosis.Options, progress: Any = None) -> object:
        key = repr((table.sha256, machine, dict(known.values), known.covariance.tolist(), options))
        if key not in diagnoses:
            diagnoses[key] = real(table, machine, known, options, progress)
        return diagnoses[key]

    monkeypatch.setattr(diagnosis, "diagnose", once)


@pytest.mark.usefixtures("diagnosed_once")
def test_the_same_seed_says_the_same_in_any_process(offset_table: Path, capsys) -> None:
    """To the last digit, also where sets of strings are in another order."""
    assert main(["diagnose", str(offset_table), "--json"]) == 0
    environment = {**os.environ, "PYTHONHASHSEED": "2", "PYTHONPATH": str(DATA.parents[1])}
    command = [sys.executable, "-m", "yieldmon", "diagnose", str(offset_table), "--seed", "1", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout == capsys.readouterr().out


@pytest.mark.parametrize(("name", "f_before", "f_after"), [("dem", 12.0, 1.6), ("bench", 12.0, 3.0)])
def test_published_tables(name: str, f_before: float, f_after: float) -> None:
    """Two effects close the published model's misfit; the confidence of their names is reported."""
    # The command's output, as tests/golden holds it.
    found = json.loads(kept.load(f"diagnose-{name}"))
    assert found["verdict"] == "effect"
    assert len(found["effects"]) == 2
    assert found["gap"]["before"]["lack_of_fit_f"] > f_before
    assert found["gap"]["after"]["lack_of_fit_f"] <= f_after
    assert set(found["gap"]["before"]) >= {"rms", "rms_over_max_pct", "lack_of_fit_f", "p_value"}
    assert set(found["effects"][0]) >= {"name", "stage", "parameters", "confidence", "equivalent"}
    assert 0.2 < found["effects"][0]["confidence"] < 0.6
    assert any("comes from one cell, plate 50 deg and 0.3 kg" in note for note in found["notes"]) == (name == "bench")
    assert found["next_experiment"]["rows"]
    assert set(found["next_experiment"]["rows"][0]) == {"plate_angle_deg", "mass_flow_kg_s", "elevator_speed_rpm"}


@pytest.mark.usefixtures("diagnosed_once")
def test_loads_of_a_table_calibrate_a_machine_and_sweeps_do_not(offset_table: Path, tmp_path: Path) -> None:
    """scale_sd: of the flows that a store's sweeps are given, which no load of a table has."""
    parent, path = parameter_file.not_calibrated(parameter_file.load()), tmp_path / "p.yaml"
    carried = replace(parent, provenance={**parent.provenance, SCALE: CARRIED, CARRIED_FROM: "wheat", "crop": "corn"})
    found = diagnosis.diagnose(table.load(offset_table), Machine(), parent, diagnosis.Options())
    for before in (parent, carried):
        parameter_file.save(before, path)
        for scale_sd, error in ((0.0, 0.0), (0.08, before.scale_error)):
            out = tmp_path / f"{before.carried_from}{scale_sd}.yaml"
            data, now = ("data", "0" * 64), datetime(2026, 7, 1, tzinfo=UTC)
            adoption.adopt(found, before, parent_path=path, out=out, data=data, now=now, scale_sd=scale_sd)
            assert parameter_file.load(out).scale_error == error
            assert parameter_file.load(out).provenance.get("crop") == before.provenance.get("crop")


@pytest.mark.usefixtures("diagnosed_once")
def test_adopt_plan_report_and_rollback(offset_table: Path, tmp_path: Path, capsys) -> None:
    params, plan, report = tmp_path / "p.yaml", tmp_path / "next.csv", tmp_path / "report"
    params.write_bytes((DATA.parents[1] / "config/parameters/corn.yaml").read_bytes())
    parent = params.read_bytes()
    written = (plan, plan.with_suffix(".sweep.yaml"), report / "index.html", report / "where.png")
    report.mkdir()
    kept = []
    for path in written:
        path.write_text("old")
        # Another name for what is there before: a file that is written over in place changes under both.
        kept.append(path.with_name(f"kept-{path.name}"))
        kept[-1].hardlink_to(path)
    code = main(
        [
            "diagnose",
            str(offset_table),
            "--params",
            str(params),
            "--adopt",
            str(params),
            "--plan",
            str(plan),
            "--report",
            str(report),
            "--force",
        ]
    )
    said = capsys.readouterr()
    assert code == 0, said.err
    assert "verdict: effect" in said.out
    lines = said.out.splitlines()
    head = next(number for number, line in enumerate(lines) if "model - measurement, %" in line)
    assert re.fullmatch(r"\s+\d+( to \d+)?\s+0\.\d{3}( to 0\.\d{3})?\s+\d+( to \d+)?\s+[-+]\d+\.\d\s+\S+", lines[head + 1])
    assert "{" not in said.out
    adopted = parameter_file.load(params)
    assert adopted.effects == ("zero_offset",)
    assert (adopted.version, adopted.provenance["parent_version"]) == (2, "1")
    assert re.fullmatch("[0-9a-f]{64}", adopted.provenance["data_sha256"])
    assert float(adopted.provenance["gap_before_rms"]) > float(adopted.provenance["gap_after_rms"])
    assert plan.read_text().startswith("plate_angle_deg,mass_flow_kg_s,elevator_speed_rpm,repeats\n")
    assert "angles_deg: [" in plan.with_suffix(".sweep.yaml").read_text()
    page = (report / "index.html").read_text()
    assert "zero-load reading" in page
    assert re.search(r"force_n = -?[0-9.]+ ± [0-9.]+ N", page)
    assert not re.search(r'(src|href)="(?!data:)', page)
    # Held-out lack of fit with its interval, and no share above 100 %.
    assert len(re.findall(r"<td>[0-9.]+ \([0-9.]+ to [0-9.]+\)</td>", page)) == 2
    assert "closed" not in page
    assert "<th>power at the 5 % level</th>" in page
    assert [path.read_text() for path in kept] == ["old"] * len(kept)
    assert {p.name for p in report.glob("[!k]*.png")} == {"where.png", "after.png", "profiles.png", "ranking.png"}

    assert main(["diagnose", "--rollback", str(params)]) == 0
    assert params.read_bytes() == parent
    assert parameter_file.load(params.with_name("p.v2.rolled-back.yaml")).effects == ("zero_offset",)


@pytest.mark.usefixtures("diagnosed_once")
def test_a_link_to_the_parameters_stays_a_link(offset_table: Path, tmp_path: Path) -> None:
    params, link = tmp_path / "kept" / "corn.yaml", tmp_path / "corn.yaml"
    params.parent.mkdir()
    parameter_file.save(parameter_file.load(DATA.parents[1] / "config/parameters/corn.yaml"), params)
    parent = params.read_bytes()
    link.symlink_to(params)
    assert main(["diagnose", str(offset_table), "--params", str(link), "--adopt", str(link)]) == 0
    assert main(["diagnose", "--rollback", str(link)]) == 0
    assert link.is_symlink()
    assert params.read_bytes() == parent


@pytest.mark.usefixtures("diagnosed_once")
def test_what_is_adopted_and_rolled_back_is_for_the_services_user(offset_table: Path, tmp_path: Path) -> None:
    params = tmp_path / "p.yaml"
    params.write_bytes((DATA.parents[1] / "config/parameters/corn.yaml").read_bytes())
    params.chmod(0o600)
    before = os.umask(0o077)
    try:
        for arguments in ([str(offset_table), "--params", str(params), "--adopt", str(params)], ["--rollback", str(params)]):
            assert main(["diagnose", *arguments]) == 0
            assert {path.stat().st_mode & 0o777 for path in tmp_path.glob("p*.yaml")} == {0o644}
    finally:
        os.umask(before)
    assert {path.name for path in tmp_path.glob("p*.yaml")} == {"p.yaml", "p.v1.parent.yaml", "p.v2.rolled-back.yaml"}


def test_rollback_refuses_an_altered_parent(offset_table: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "p.yaml"
    assert main(["diagnose", str(offset_table), "--adopt", str(out), "--hold-out", "trials"]) == 0
    before = out.read_bytes()
    copy = tmp_path / "p.v1.parent.yaml"
    copy.write_text(copy.read_text() + "# touched\n")
    assert main(["diagnose", "--rollback", str(out)]) == 2
    assert "is not the parent" in capsys.readouterr().err
    assert out.read_bytes() == before


def test_report_without_matplotlib_says_what_to_install(offset_table: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["diagnose", str(offset_table), "--report", str(tmp_path / "r")]) == 2
    assert "pip install 'yieldmon[plot]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "no table given"),
        (["{table}", "--without", "ghost"], "'ghost' is not an effect"),
        (["{table}", "--hold-out", "plate_angle_deg=12"], "holds out 0 of"),
        (["no-such.csv"], "no-such.csv"),
        (["{few}"], "has 3 rows"),
        (["--rollback", "{params}"], "names no parent"),
        (["{table}", "--plan", "no-such-folder/next.csv"], "there is no folder"),
    ],
)
def test_bad_input_gets_one_line(arguments: list[str], says: str, offset_table: Path, tmp_path: Path, capsys) -> None:
    few = tmp_path / "few.csv"
    few.write_text("plate_angle_deg,mass_flow_kg_s,force_n\n40,5,10\n60,5,20\n80,5,30\n")
    names = {"table": offset_table, "few": few, "params": DATA.parents[1] / "config/parameters/corn.yaml"}
    assert main(["diagnose", *(a.format(**names) for a in arguments)]) == 2
    error = capsys.readouterr().err.strip()
    assert says in error
    assert error.startswith("yieldmon: ")
    assert len(error.splitlines()) == 1


def test_effects_that_are_given_are_kept_and_not_searched(offset_table: Path, tmp_path: Path, capsys) -> None:
    """A zero offset that the parameters already have is found again unless it is kept; then nothing is missing."""
    shipped_set = parameter_file.load(None)
    reported = tmp_path / "told.yaml"
    grain = {name: value for name, value in shipped_set.values.items() if "." not in name}
    parameter_file.save(replace(shipped_set, values={**grain, "zero_offset.force_n": 4.0}), reported)
    command = ["diagnose", str(offset_table), "--params", str(reported), "--json"]
    assert main(command) == 0
    assert [effect["name"] for effect in json.loads(capsys.readouterr().out)["effects"]] == ["zero_offset"]
    assert main([*command, "--keep-effects"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["verdict"], found["effects"]) == ("none", [])


@pytest.mark.parametrize(
    ("noise", "error", "said"),
    [(0.01, 0.0, "as well as they repeat"), (0.001, 0.002, "within the 0.2 % by which models of the same physics differ")],
)
def test_a_gap_within_the_model_s_own_error_is_reported_to_be_one(
    make_rows, start, noise: float, error: float, said: str
) -> None:
    """`none` may have an F that is significant against the noise alone."""
    rows = make_rows(noise=noise, alter=lambda force, angle, *_: force * (1.0 + error * np.sin(6.0 * angle)))
    found = diagnosis.diagnose_rows(rows, start)
    assert found.verdict == "none"
    assert said in report.summary(found)


@pytest.mark.parametrize(
    ("how", "said"), [("outliers", "not all rows together"), ("machines", "do not show whether the model fits")]
)
def test_rows_that_do_not_settle_the_fit_are_not_said_to_fit(make_rows, start, how: str, said: str) -> None:
    """Two of three repetitions are wrong in a held-out condition; rows of a machine of another gain stand among the others."""
    rows = make_rows()
    if how == "machines":
        rows = replace(rows, value=rows.value * (0.98 + 0.02 * np.array([float(t) for t in rows.trial])))
    else:
        held = np.flatnonzero(hold_out(rows, "cells", 1))
        condition = np.flatnonzero(rows.cell == rows.cell[held[0]])
        rows = replace(rows, value=np.where(np.isin(np.arange(len(rows)), condition[:2]), 1.5, 1.0) * rows.value)
    found = diagnosis.diagnose_rows(rows, start)
    assert found.verdict == "none"
    assert said in report.summary(found)
    assert "Nothing to correct" not in report.summary(found)
