"""Tables of a facility in other units, from other lines, with columns of other names: asked about, nothing of numpy's said."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from yieldmon import api
from yieldmon.cli.main import main

LOADS_KG_S, ANGLES_DEG = (4.0, 9.0, 14.0), (45.0, 55.0, 65.0, 75.0, 85.0)
GRAIN = {"friction": 0.32, "restitution": 0.45, "density": 1050.0, "shape_ratio": 2.0}
AT = api.Conditions(np.radians(ANGLES_DEG)[:, None], 400.0 * api.RPM, mass_flow_kg_s=np.array(LOADS_KG_S))
FORCES_N = api.ForwardModel(api.Machine()).force(AT, GRAIN)


def table(folder: Path, *, load: float = 1.0, force: float = 1.0, turned_deg: float | None = None, name: str = "force_n") -> Path:
    """Fifteen cells read twice; loads and forces times a factor, angles from another line."""
    lines = [f"plate_angle_deg,mass_flow_kg_s,{name},run"]
    for angle, forces in zip(ANGLES_DEG, FORCES_N, strict=True):
        written = angle if turned_deg is None else turned_deg - angle
        for flow, newtons in zip(LOADS_KG_S, forces, strict=True):
            lines += [f"{written:g},{load * flow:g},{force * (newtons + 0.1 * trial):.3f},{flow:g}" for trial in (0, 1)]
    path = folder / "facility.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ({}, ""),
        ({"load": 3.6}, "is mass_flow_kg_s in kg/s, not t/h or lb/s, and force_n in newtons?"),
        ({"load": 1.0 / 0.45359237}, "is mass_flow_kg_s in kg/s, not t/h or lb/s, and force_n in newtons?"),
        ({"force": 1.0 / 4.448}, "is mass_flow_kg_s in kg/s, not t/h or lb/s, and force_n in newtons?"),
        ({"force": 2.5}, "is mass_flow_kg_s in kg/s, not t/h or lb/s, and force_n in newtons?"),
    ],
    ids=["right", "t/h", "lb/s", "lbf", "too large"],
)
def test_units(factors: dict[str, float], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(table(tmp_path, **factors)), "--starts", "2"]) == 0
    asked = [line for line in capsys.readouterr().err.splitlines() if "times that of grain" in line]
    assert (asked[0][-len(said) :] if asked else "") == said


@pytest.mark.parametrize(
    ("force", "code", "said"),
    [
        (1.0 / 9.80665, 2, "times that of grain on this machine; expected newtons; these look like kilograms-force"),
        (1e3, 2, "times that of grain on this machine; expected newtons"),
        (1.0 / 4.448, 0, "and force_n in newtons?"),
        (1.0, 0, ""),
    ],
    ids=["kgf", "mN", "lbf", "right"],
)
def test_diagnose_looks_at_the_units_as_calibrate_does(
    force: float, code: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A gain that fits any unit fits these rows as well: nothing else would be said of them than that nothing is missing."""
    assert main(["diagnose", str(table(tmp_path, force=force))]) == code
    captured = capsys.readouterr()
    asked = [line for line in captured.err.splitlines() if "times that of grain" in line]
    assert said in "".join(asked)
    assert bool(asked) is bool(said)
    assert (captured.out == "") is (code == 2)


CAMPAIGN, PUBLISHED = (Path(__file__).parents[1] / "data" / name for name in ("dem_campaign.csv", "dem_table.csv"))


def in_pounds(source: Path, folder: Path, **only: str) -> Path:
    """Rows of a recorded table with paddle_mass_kg in pounds."""
    with source.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if all(row[k] == v for k, v in only.items())]
    columns = ["plate_angle_deg", "paddle_mass_kg", "momentum_kg_m_s"]
    lines = [",".join([row[columns[0]], f"{float(row[columns[1]]) / 0.45359237:g}", row[columns[2]]]) for row in rows]
    path = folder / "pounds.csv"
    path.write_text("\n".join((",".join(columns), *lines)) + "\n", encoding="utf-8")
    return path


def asked_of(argv: list[str], capsys: pytest.CaptureFixture[str]) -> list[str]:
    assert main(argv) == 0
    return [line for line in capsys.readouterr().err.splitlines() if "times that of grain" in line]


@pytest.mark.parametrize("friction", ["0.15", "0.3"])
def test_masses_in_pounds_are_asked_about(friction: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Readings 0.34 to 0.39 times those of grain, by an engine that shares no law with the model."""
    table_in_pounds = in_pounds(CAMPAIGN, tmp_path, friction=friction, elevator_speed_rpm="400")
    assert asked_of(["calibrate", str(table_in_pounds), "--starts", "2"], capsys)


def test_right_units_are_not_asked_about_where_the_rows_refute_every_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The published discrete elements read 0.35 times what grain gives, as those of the campaign do in pounds."""
    assert not asked_of(["calibrate", str(PUBLISHED), "--starts", "2"], capsys)
    assert not asked_of(["calibrate", str(CAMPAIGN), "--starts", "2"], capsys), "0.66 times, as grain in pounds per second"
    assert asked_of(["calibrate", str(in_pounds(PUBLISHED, tmp_path)), "--starts", "2"], capsys)


@pytest.mark.parametrize(("unit", "asked"), [(1.0, False), (3.6, True)], ids=["kg/s", "t/h"])
def test_loads_that_no_paddle_holds_are_asked_about(
    unit: float, asked: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A machine whose force is 1.2 times that of shipped grain, by a law of its own: in t/h it reads 0.55 times grain."""
    lines = ["plate_angle_deg,mass_flow_kg_s,force_n"]
    for angle in np.radians([40.0, 55.0, 70.0, 85.0]):
        for flow in (4.0, 8.0, 12.0, 16.0, 20.0):
            force = 15.1 * flow * np.sin(angle) * np.sin(angle - np.radians(15.0)) / (1.0 + 0.02 * flow)
            lines += [f"{np.degrees(angle):g},{unit * flow:g},{force + trial:.3f}" for trial in (0.0, 0.3)]
    path = tmp_path / "facility.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert bool(asked_of(["calibrate", str(path), "--starts", "2"], capsys)) is asked


def test_units_of_a_table_by_moisture_are_asked_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path, load=3.6)
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    more = [f"{row},{moisture}" for moisture in (14, 18) for row in rows]
    path.write_text("\n".join((f"{header},moisture_pct", *more)) + "\n", encoding="utf-8")
    assert main(["calibrate", str(path), "--starts", "2", "--by-moisture"]) == 0
    assert "times that of grain on this machine: is mass_flow_kg_s in kg/s" in capsys.readouterr().err


@pytest.mark.filterwarnings("error")
def test_another_line_from_which_no_grain_would_land(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Counter-clockwise angles from 100 deg: counted from the vertical they lie below the horizontal, where nothing lands."""
    assert main(["calibrate", str(table(tmp_path, turned_deg=180.0)), "--starts", "2"]) == 0
    assert "with 180 deg less each plate angle the model would miss by" in capsys.readouterr().out


def test_rows_that_have_updated_the_parameters_before_are_said_to_count_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Deviations that are 0.7 times what they should be pass for knowledge."""
    rows, out = str(table(tmp_path)), str(tmp_path / "p.yaml")
    other = tmp_path / "other"
    other.mkdir()
    others = str(table(other, force=1.01))
    fit = ["calibrate", rows, "--starts", "2", "--force", "--out", out]
    assert main(fit) == 0
    assert "count twice" not in capsys.readouterr().err
    for again, twice in (
        (["calibrate", rows, "--starts", "2", "--prior", out], True),
        (["calibrate", others, "--starts", "2", "--prior", out], False),
        (["self-calibrate", rows, "--group-by", "run", "--params", out], True),
        (["self-calibrate", others, "--group-by", "run", "--params", out], False),
    ):
        assert main(again) == 0
        said = f"the parameters of {again[-2]} come from this table, so its rows count twice"
        assert (said in capsys.readouterr().err) is twice, again


@pytest.mark.parametrize("given", [True, False])
def test_a_column_that_groups_is_not_said_to_be_ignored(given: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--group-by", "run"] if given else []
    assert main(["self-calibrate", str(table(tmp_path)), *options]) == 0
    assert ("'run' is not known" in capsys.readouterr().err) is not given


def test_columns_of_other_names_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(table(tmp_path, name="Force [N]"))]) == 2
    assert capsys.readouterr().err.endswith("(it has 'force [n]', 'run')\n")


def rows_of(folder: Path, flows_kg_s: Sequence[float], angles_deg: Sequence[float]) -> str:
    """A table of these conditions, each read ten times with noise of 1 % (seed 5)."""
    at = api.Conditions(np.radians(angles_deg)[:, None], 400.0 * api.RPM, mass_flow_kg_s=np.asarray(flows_kg_s))
    forces, rng = api.ForwardModel(api.Machine()).force(at, GRAIN), np.random.default_rng(5)
    cells = [(a, q, float(forces[i, j])) for i, a in enumerate(angles_deg) for j, q in enumerate(flows_kg_s)]
    lines = [f"{a:g},{q:g},{newtons * (1.0 + 0.01 * rng.standard_normal()):.3f}" for a, q, newtons in cells for _ in range(10)]
    path = folder / "few.csv"
    path.write_text("\n".join(["plate_angle_deg,mass_flow_kg_s,force_n", *lines]) + "\n", encoding="utf-8")
    return str(path)


def test_a_comparison_of_two_loads_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", rows_of(tmp_path, [5.0, 10.0], [50.0, 70.0]), "--compare", "--starts", "2"]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("yieldmon: --compare: 2 loads; cross-validation over loads needs 3 or more")


def test_a_comparison_leaves_out_the_model_that_the_other_loads_cannot_fix(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", rows_of(tmp_path, [5.0, 10.0, 15.0], [70.0]), "--compare", "--starts", "2"]) == 0
    printed = capsys.readouterr()
    assert "alpha-beta" in printed.out
    assert "physical model" not in printed.out
    assert "--compare: without a load the others cannot fix the physical model's 3 parameters" in printed.err


def test_three_conditions_are_not_asked_for_a_fourth_parameter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where 1 + e ends at its bound the exchange coefficients take its place only if the rows can determine one more."""
    path = Path(rows_of(tmp_path, [5.0, 10.0, 15.0], [70.0]))
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    raised = [f"{a},{q},{1.9 * float(f):.3f}" for a, q, f in (line.split(",") for line in lines)]
    path.write_text("\n".join([header, *raised]) + "\n", encoding="utf-8")
    assert main(["calibrate", str(path), "--starts", "2"]) == 0
    assert "k1" not in capsys.readouterr().out
