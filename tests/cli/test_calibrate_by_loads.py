"""`calibrate --loads` on logs of a virtual combine whose grain is not the shipped corn."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest

from tests.schema_check import problems
from yieldmon.cli.main import main
from yieldmon.files import parameter_file
from yieldmon.physics.machine import Machine

FLOWS = (5, 12, 18, 9)


@pytest.fixture(scope="module")
def loads(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], list[float]]:
    """Four logs of a minute's harvest each, and their true masses."""
    folder = tmp_path_factory.mktemp("loads")
    logs, masses = [], []
    for k, flow in enumerate(FLOWS, 1):
        pieces = [{"kind": "steady", "duration_s": s, "flow_kg_s": f} for s, f in ((8, 0), (60, flow), (8, 0))]
        scenario = {
            "duration_s": 76,
            "crop": {"friction": 0.2, "restitution": 0.45, "bulk_density_kg_m3": 1300},
            "flow": {"variation_pct": 5, "smoothing_s": 0.7, "pieces": pieces},
        }
        (folder / "s.yaml").write_text(json.dumps(scenario))
        log, truth = folder / f"load{k}.log.gz", folder / "t.csv"
        words = ["--scenario", folder / "s.yaml", "--log", log, "--truth", truth, "--seed", k]
        assert main(["simulate", *map(str, words)]) == 0
        logs.append(str(log))
        masses.append(float(truth.read_text().splitlines()[-1].split(",")[2]))
        truth.unlink()
    return logs, masses


def tickets(folder: Path, rows: list[tuple[object, float]], header: str = "load,weighed_kg") -> str:
    path = folder / "tickets.csv"
    path.write_text("\n".join([header, *(f"{load},{kg}" for load, kg in rows)]) + "\n")
    return str(path)


def test_loads_calibrate_a_curve_that_measures_them(loads, tmp_path, capsys):
    logs, masses = loads
    curve, rows = tmp_path / "curve.yaml", list(enumerate(masses, 1))
    words = ["--estimator", "alpha_beta", "--tickets", tickets(tmp_path, rows), "--out", str(curve), "--json"]
    assert main(["calibrate", "--loads", *logs, *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert problems(found, "calibrate-curve") == []
    assert (found["estimator"], found["loads"], found["plate_angles_deg"]) == ("alpha_beta", 4, [pytest.approx(70.0)])
    out = ["--out", str(tmp_path / "out.csv"), "--jobs", "1", "--json"]
    assert main(["process", logs[1], "--estimator", str(curve), *out]) == 0
    measured_kg = json.loads(capsys.readouterr().out)["total_mass_kg"]
    assert measured_kg == pytest.approx(masses[1], rel=max(0.01, 2.0 * found["relative_std_dev_pct"] / 100.0))


def test_three_loads_calibrate_and_a_fourth_of_another_truck_is_named(loads, tmp_path, capsys):
    logs, masses = loads
    out = tmp_path / "wheat.yaml"
    rows = [("load1", masses[0]), (2, masses[1]), (3, masses[2]), (4, 1.2 * masses[3])]
    assert main(["calibrate", "--loads", *logs, "--tickets", tickets(tmp_path, rows), "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert problems(found, "calibrate-loads") == []
    assert [load["outlier"] for load in found["loads"]] == [False, False, False, True]
    assert found["residual"]["outlier_rows"] == [4]
    for load, true_kg in zip(found["loads"], masses, strict=True):
        assert load["after_kg"] == pytest.approx(true_kg, rel=0.012)
    assert abs(found["loads"][0]["before_kg"] / masses[0] - 1.0) > 0.04
    assert 0.1 < found["next_load_sd_pct"] < 2.0
    assert {"friction", "shape_ratio"} <= set(found["held"])
    written = parameter_file.load(out)
    assert written.values["density"] == found["parameters"]["density"]["value"]
    assert written.provenance["method"] == "3 weighed loads"
    assert parameter_file.on_a_machine(written, Machine()).scale_error == 0.0
    assert parameter_file.on_a_machine(written, Machine(paddle_width_m=0.25)).scale_error > 0.3
    # A second time from there: nothing better is to be had, and the file stays.
    stamp = out.read_bytes()
    again = ["calibrate", "--loads", *logs[:3], "--tickets", tickets(tmp_path, rows[:3]), "--prior", str(out)]
    assert main(again) == 1
    assert "refused" in capsys.readouterr().out
    assert out.read_bytes() == stamp


def test_two_loads_leave_the_curve_of_the_force_open_and_say_what_to_do(loads, tmp_path, capsys):
    logs, masses = loads
    rows = [("load1", masses[0]), ("load3", masses[2])]
    assert main(["calibrate", "--loads", logs[0], logs[2], "--tickets", tickets(tmp_path, rows)]) == 0
    shown = capsys.readouterr().out
    assert "do not show whether the force follows the model's curve" in shown
    assert "weigh loads at other flows" in shown


@pytest.mark.parametrize(
    ("header", "row", "problem"),
    [
        ("load,weighed_kg", "9,1000", "line 2, load: is 9, no load that was measured; expected 1 to 2"),
        ("load,weighed", "1,1000", "header: weighed has no unit; expected weighed_kg, weighed_t or weighed_lb"),
        ("load,weighed_kg", "1,tons", "line 2, weighed_kg: is 'tons'; expected a number"),
        ("load,weighed_kg", '1,"1,076.1"', "weighed_kg: is '1,076.1'; expected a number, without unit or thousands separator"),
        ("load,weighed_kg", "1,306 kg", "weighed_kg: is '306 kg'; expected a number, without unit or thousands separator"),
        ("load,weighed_t", "1,9000", "line 2, weighed_t: is 9e+06 kg"),
        ("weighed_kg", "700", "header: has no column load"),
        ("load,weighed_kg,std_dev_kg", "1,700,0", "std_dev_kg: is 0 kg; expected above 0"),
        (
            "load,weighed_kg",
            "1,700\n1,700",
            "line 3, load: load 1 has a ticket already (line 2); expected one row for each load: the right one; or, ",
        ),
    ],
)
def test_bad_tickets_are_named_in_one_line(loads, tmp_path, capsys, header, row, problem):
    path = tmp_path / "t.csv"
    path.write_text(f"{header}\n{row}\n")
    assert main(["calibrate", "--loads", *loads[0][:2], "--tickets", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert problem in err


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--loads", "a.log"], "--tickets: is missing"),
        ([], "DATA: is missing"),
        (["--loads", "a.db", "b.db", "--tickets", "t.csv"], "--loads: names a.db together with other sources"),
        (["--loads", "a.log", "a.log", "--tickets", "t.csv"], "--loads: names a.log twice"),
        (["t.csv", "--loads", "a.log", "--tickets", "t.csv"], "t.csv: is given together with --loads"),
        (["--loads", "a.log", "--tickets", "t.csv", "--robust"], "--robust: applies to a table"),
        (["--loads", "a.log", "--tickets", "t.csv", "--stop-gap"], "--stop-gap: applies to a table"),
        (["--loads", "a.log", "--tickets", "t.csv", "--starts", "5"], "--starts: applies to a table"),
        (["--loads", "a.log", "--tickets", "t.csv", "--seed", "0"], "--seed: applies to a table"),
        (["--loads", "a.log", "--tickets", "t.csv"], "a.log: No such file"),
        (["--loads", "a.db", "--tickets", "t.csv"], "a.db: no such file"),
    ],
)
def test_wrong_words_are_named_in_one_line(tmp_path, monkeypatch, capsys, words, problem):
    monkeypatch.chdir(tmp_path)
    Path("t.csv").write_text("load,weighed_kg\n1,1000\n")
    assert main(["calibrate", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert problem in err


def test_a_copy_of_a_log_under_another_name_is_refused(loads, tmp_path, capsys):
    logs, masses = loads
    copy = tmp_path / "monday.log"
    copy.write_bytes(gzip.decompress(Path(logs[1]).read_bytes()))
    rows = [("load1", masses[0]), ("load2", masses[1]), ("monday", masses[1])]
    assert main(["calibrate", "--loads", *logs[:2], str(copy), "--tickets", tickets(tmp_path, rows)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert f"monday.log: is the same log as {logs[1]}, one of them gzipped, and would double its mass" in err


def test_a_load_measured_at_twice_its_mass_leaves_the_columns_apart(loads, tmp_path, capsys):
    logs, masses = loads
    path = tickets(tmp_path, [(2, 0.45 * masses[1])])
    assert main(["calibrate", "--loads", *logs[:2], "--tickets", path]) == 0
    heads, row = (line.split() for line in capsys.readouterr().out.splitlines()[:2])
    assert heads[:7] == ["load", "weighed", "kg", "before", "kg", "after", "kg"]
    assert row[0] == "2"
    before_kg, apart = float(row[2]), row[3]
    assert float(apart) == pytest.approx(100.0 * (before_kg / float(row[1]) - 1.0), abs=0.5)
    assert float(apart) > 100.0


def test_a_log_that_begins_in_grain_says_why_there_is_no_mass_and_takes_a_zero(tmp_path, capsys):
    pieces = [{"kind": "steady", "duration_s": 40, "flow_kg_s": 12}]
    (tmp_path / "s.yaml").write_text(json.dumps({"duration_s": 30, "flow": {"pieces": pieces}}))
    log, out = tmp_path / "grain.log", tmp_path / "x.csv"
    assert main(["simulate", "--scenario", str(tmp_path / "s.yaml"), "--log", str(log)]) == 0
    capsys.readouterr()
    assert main(["process", str(log), "--out", str(out)]) == 0
    assert "no mass: the elevator never runs empty in the log" in capsys.readouterr().err
    assert main(["process", str(log), "--out", str(out), "--force", "--zero-mv", "500", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["total_mass_kg"] == pytest.approx(12.0 * 29.0, rel=0.06)
