"""predict, estimate, calibrate and self-calibrate as a user runs them."""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path

import numpy as np
import pytest

from yieldmon.cli.main import main
from yieldmon.files import moisture_file, parameter_file
from yieldmon.resources import shipped

DATA = Path(__file__).parents[1] / "data"
PUBLISHED = ["--params", str(shipped("config/parameters/published-example.yaml"))]


def run(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> str:
    assert main([str(w) for w in words]) == code
    out, err = capsys.readouterr()
    if code:
        assert out == ""
        assert err.count("\n") == 1
        return err
    return out


def document(capsys: pytest.CaptureFixture[str], *words: object) -> dict:
    return json.loads(run(capsys, *words, "--json"))


@pytest.fixture
def sweep_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """Forces at three flows and eleven angles of drifted grain."""
    rows = document(
        capsys,
        "predict",
        "--mass-flow",
        "6,12,20",
        "--plate-angle",
        "40:90:5",
        *PUBLISHED,
        "--set",
        "friction=0.25",
        "--set",
        "restitution=0.63",
        "--set",
        "density=1150",
    )["rows"]
    path = tmp_path / "sweep.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["plate_angle_deg", "mass_flow_kg_s", "force_n"])
        writer.writerows([r["plate_angle_deg"], r["mass_flow_kg_s"], r["force_n"]] for r in rows)
    return path


@pytest.fixture
def known() -> Path:
    return shipped("config/parameters/published-example.yaml")


# predict


def test_predict_gives_a_row_for_each_combination(capsys: pytest.CaptureFixture[str]) -> None:
    rows = document(
        capsys, "predict", "--mass-flow", "2,5", "9", "--plate-angle", "40:70:15", "--elevator-speed", "350", "400", *PUBLISHED
    )["rows"]
    assert len(rows) == 18
    assert [r["mass_flow_kg_s"] for r in rows[::6]] == [2.0, 5.0, 9.0]
    assert rows[0]["plate_angle_deg"] == 40.0
    for r in rows:
        passes = r["mass_flow_kg_s"] / r["paddle_mass_kg"]
        assert r["force_n"] == pytest.approx(r["paddle_momentum_kg_m_s"] * passes)
    # Table 11.2: 9 kg/s at 70 deg.
    assert rows[-1]["elevator_speed_rpm"] == 400.0
    assert rows[-1]["paddle_momentum_kg_m_s"] == pytest.approx(6.84, rel=0.004)


def test_predict_csv_has_the_same_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("predict", "--mass-flow", "2,25", "--plate-angle", "70", *PUBLISHED)
    rows = document(capsys, *words)["rows"]
    lines = list(csv.DictReader(io.StringIO(run(capsys, *words))))
    assert [float(line["mass_flow_kg_s"]) for line in lines] == [2.0, 25.0]
    for line, row in zip(lines, rows, strict=True):
        assert {k: float(v) for k, v in line.items()} == pytest.approx(row, rel=1e-9)


def test_predict_with_an_effect_set_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    plain = document(capsys, "predict", "--mass-flow", "5")["rows"][0]["force_n"]
    offset = document(capsys, "predict", "--mass-flow", "5", "--set", "zero_offset.force_n=2.5")["rows"][0]["force_n"]
    assert offset - plain == pytest.approx(2.5)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--mass-flow", "500"], "a full paddle"),
        (["--mass-flow", "-1"], "--mass-flow: is -1"),
        (["--mass-flow", "two"], "--mass-flow: is 'two'; expected a finite number"),
        (["--mass-flow", "5:2:1"], "first:last:step"),
        (["--mass-flow", "5", "--plate-angle", "200"], "--plate-angle: is 200"),
        (["--mass-flow", "5", "--elevator-speed", "0"], "above 0 rpm"),
        (["--mass-flow", "5", "--set", "colour=1"], "colour is not a parameter"),
        (["--mass-flow", "5", "--set", "friction"], "expected NAME=VALUE"),
        (["--mass-flow", "5", "--set", "restitution=2"], "is 2; expected 0 to 1"),
        (["--mass-flow", "5", "--set", "nothing.here=2"], "effect 'nothing': unknown"),
        (["--mass-flow", "5", "--set", "k1=2"], "k1 and k2"),
        (["--mass-flow", "5", "--params", "none.yaml"], "none.yaml"),
        (["--mass-flow", "5", "--moisture", "nan"], "--moisture: is nan; expected 0 to 100 %"),
        (["--mass-flow", "5", "--moisture", "-4"], "--moisture: is -4"),
    ],
)
def test_predict_refuses_in_one_line(capsys: pytest.CaptureFixture[str], words: list[str], message: str) -> None:
    assert message in run(capsys, "predict", *words, code=2)


# estimate


def test_estimate_finds_the_flows_that_predict_took(capsys: pytest.CaptureFixture[str], sweep_table: Path) -> None:
    words = [*PUBLISHED, "--set", "friction=0.25", "--set", "restitution=0.63", "--set", "density=1150"]
    rows = document(capsys, "estimate", sweep_table, *words)["rows"]
    assert len(rows) == 33
    for row in rows:
        assert row["mass_flow_kg_s"] == pytest.approx(row["true_mass_flow_kg_s"], rel=1e-6)
        assert row["status"] == "ok"
        assert abs(row["error_pct"]) < 1e-4


@pytest.mark.parametrize(
    ("value", "status"), [("", "not_available"), ("-", "not_available"), ("0", "no_grain"), ("1e5", "saturated")]
)
def test_estimate_gives_a_status_for_each_row(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, value: str, status: str
) -> None:
    path = tmp_path / "t.csv"
    path.write_text(f"plate_angle_deg,force_n\n70,{value}\n70,50\n")
    rows = document(capsys, "estimate", path, "--sigma", "1", *PUBLISHED)["rows"]
    assert rows[0]["status"] == status
    assert (rows[0]["mass_flow_kg_s"] is None) == (status in ("not_available", "saturated"))
    assert rows[1]["status"] == "ok"
    assert rows[1]["std_dev_kg_s"] > 0.0


@pytest.mark.parametrize(("own", "said"), [(False, True), (True, False)], ids=["of other grain", "of its own calibration"])
def test_estimate_says_where_flows_contradict_the_tables_own_loads(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, own: bool, said: bool
) -> None:
    dem, params = Path(__file__).resolve().parents[1] / "data" / "dem_table.csv", tmp_path / "p.yaml"
    if own:
        assert main(["calibrate", str(dem), "--out", str(params)]) == 0
    capsys.readouterr()
    assert main(["estimate", str(dem), "--params", str(params) if own else "corn"]) == 0
    told = capsys.readouterr().err
    assert (" standard deviations); expected parameters of this grain and machine" in told) == said
    assert told.count("\n") == int(said)


@pytest.mark.parametrize("sigma", ["-1", "nan", "inf"])
def test_estimate_refuses_noise_that_is_none(capsys: pytest.CaptureFixture[str], tmp_path: Path, sigma: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text("plate_angle_deg,force_n\n70,50\n")
    assert "--sigma: is " in run(capsys, "estimate", path, "--sigma", sigma, code=2)


@pytest.mark.parametrize(("out", "problem"), [("nowhere/x.yaml", "there is no folder"), (".", "is a folder")])
def test_calibrate_reports_before_the_fit_that_it_cannot_write(
    capsys: pytest.CaptureFixture[str], out: str, problem: str
) -> None:
    assert problem in run(capsys, "calibrate", DATA / "dem_table.csv", "--out", out, code=2)


def test_estimate_refuses_parameters_of_another_scale(capsys: pytest.CaptureFixture[str]) -> None:
    assert "holds response" in run(capsys, "estimate", DATA / "bench_table.csv", code=2)


@pytest.mark.parametrize("moisture", [[], ["--moisture", "22"]], ids=["no moisture", "moisture"])
def test_what_predict_writes_estimate_and_calibrate_read(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, moisture: list[str]
) -> None:
    path = tmp_path / "predicted.csv"
    path.write_text(run(capsys, "predict", "--mass-flow", "2:20:6", "--plate-angle", "40:90:10", *moisture), encoding="utf-8")
    rows = document(capsys, "estimate", path)["rows"]
    assert [r["mass_flow_kg_s"] for r in rows] == pytest.approx([r["true_mass_flow_kg_s"] for r in rows], rel=1e-6)
    assert main(["calibrate", str(path), "--effects", "gravity", "--starts", "2", "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    found, shipped_values = json.loads(out)["parameters"], parameter_file.load().values
    assert {n: p["value"] for n, p in found.items()} == pytest.approx({n: shipped_values[n] for n in found}, rel=1e-4)
    assert {"friction", "density", "restitution"} <= set(found)


@pytest.mark.parametrize("verb", ["estimate", "calibrate"])
@pytest.mark.parametrize(
    ("column", "value", "problem"),
    [
        ("paddle_mass_kg", "0.3", "line 2: paddle_mass_kg: is 0.3, where mass_flow_kg_s says"),
        ("paddle_momentum_kg_m_s", "9", "line 2: momentum_kg_m_s: is 9, where force_n says"),
    ],
)
def test_a_load_or_reading_in_two_columns_must_agree(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, verb: str, column: str, value: str, problem: str
) -> None:
    lines = list(csv.DictReader(io.StringIO(run(capsys, "predict", "--mass-flow", "5,10", "--plate-angle", "50,70"))))
    lines[0][column] = value
    path = tmp_path / "t.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(lines[0]))
        writer.writeheader()
        writer.writerows(lines)
    assert problem in run(capsys, verb, path, code=2)


# calibrate


@pytest.mark.parametrize("scale", ["0", "-2", "nan", "inf"])
def test_calibrate_refuses_a_response_scale_that_is_none(capsys: pytest.CaptureFixture[str], scale: str) -> None:
    assert "--response-scale: is " in run(capsys, "calibrate", DATA / "bench_table.csv", "--response-scale", scale, code=2)


def test_calibrate_writes_what_estimate_reads(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "bench.yaml"
    found = document(capsys, "calibrate", DATA / "bench_table.csv", "--plate-angle", "70", "--starts", "3", "--out", out)
    assert found["residual"]["rms_over_max_pct"] < 5.9
    written = parameter_file.load(out)
    assert written.response_unit == "response"
    assert written.values["k2"] == found["parameters"]["k2"]["value"]
    assert len(written.provenance["data_sha256"]) == 64
    again = tmp_path / "again.yaml"
    parameter_file.save(written, again)
    assert again.read_bytes() == out.read_bytes()
    rows = document(capsys, "estimate", DATA / "bench_table.csv", "--params", out)["rows"]
    heavy = [r["error_pct"] for r in rows if r["true_mass_flow_kg_s"] > 3.0 and r["status"] == "ok"]
    assert abs(np.mean(heavy)) < 5.0


def test_calibrate_recovers_generated_parameters(capsys: pytest.CaptureFixture[str], sweep_table: Path) -> None:
    found = document(capsys, "calibrate", sweep_table, "--starts", "5")
    for name, value in {"friction": 0.25, "restitution": 0.63, "density": 1150.0}.items():
        assert found["parameters"][name]["value"] == pytest.approx(value, rel=1e-4)
        assert found["parameters"][name]["determined"]
    assert found["fixed"] == {"shape_ratio": 2.0}
    assert sum(b["starts"] for b in found["basins"]) == 5


def test_calibrate_holds_and_frees_the_parameters_given(capsys: pytest.CaptureFixture[str], sweep_table: Path) -> None:
    found = document(capsys, "calibrate", sweep_table, "--starts", "2", "--fix", "density=1150", "--free", "friction,restitution")
    assert set(found["parameters"]) == {"friction", "restitution"}
    assert found["fixed"]["density"] == 1150.0


def test_calibrate_with_a_prior_counts_the_version(
    capsys: pytest.CaptureFixture[str], sweep_table: Path, known: Path, tmp_path: Path
) -> None:
    out = tmp_path / "next.yaml"
    document(capsys, "calibrate", sweep_table, "--prior", known, "--starts", "1", "--out", out)
    written = parameter_file.load(out)
    assert written.version == 2
    assert "published-example.yaml" in written.provenance["parent"]


def test_calibrate_compares_and_explains(capsys: pytest.CaptureFixture[str]) -> None:
    text = run(
        capsys,
        "calibrate",
        DATA / "dem_table.csv",
        "--plate-angle",
        "70",
        "--impact",
        "exchange",
        "--starts",
        "2",
        "--compare",
        "--identifiability",
    )
    for part in ("force-proportional", "alpha-beta", "interpolated table", "physical model", "identifiability:"):
        assert part in text


def test_calibrate_by_moisture_writes_a_map(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    lines = ["plate_angle_deg,mass_flow_kg_s,force_n,moisture_pct"]
    for moisture, friction in ((14, 0.1), (26, 0.3)):
        rows = document(
            capsys,
            "predict",
            "--mass-flow",
            "4,8,12,16,20",
            "--plate-angle",
            "45,60,75,90",
            *PUBLISHED,
            "--set",
            f"friction={friction}",
        )
        lines += [f"{r['plate_angle_deg']},{r['mass_flow_kg_s']},{r['force_n']},{moisture}" for r in rows["rows"]]
    path = tmp_path / "wet.csv"
    path.write_text("\n".join(lines) + "\n")
    before = os.umask(0o077)
    try:
        found = document(capsys, "calibrate", path, "--by-moisture", "--starts", "2", "--out", tmp_path / "fits")
    finally:
        os.umask(before)
    modes = {path.name: path.stat().st_mode & 0o777 for path in (tmp_path / "fits", *(tmp_path / "fits").iterdir())}
    assert modes.pop("fits") == 0o755
    assert set(modes.values()) == {0o644}, "the service reads them as a user of its own"
    assert [d["parameters"]["friction"]["value"] for d in found["by_moisture"]] == pytest.approx([0.1, 0.3], rel=1e-4)
    assert moisture_file.load(tmp_path / "fits" / "moisture-map.yaml").at("friction", 20.0) == pytest.approx(0.2, rel=1e-4)


@pytest.mark.parametrize("words", [[], ["--plate-angle", "60"], ["--by-moisture"]], ids=["all", "one angle", "by moisture"])
def test_an_outlier_is_named_by_its_row_in_the_file(capsys: pytest.CaptureFixture[str], tmp_path: Path, words: list[str]) -> None:
    """Rows before it are left out: some without a reading, some at another angle or moisture."""
    lines = ["plate_angle_deg,mass_flow_kg_s,force_n,moisture_pct"]
    for moisture in (14, 26):
        rows = document(capsys, "predict", "--mass-flow", "2:20:2", "--plate-angle", "45,60,75,90", *PUBLISHED)["rows"]
        scatter = np.random.default_rng(3).normal(1.0, 0.002, len(rows))
        lines += [
            f"{r['plate_angle_deg']},{r['mass_flow_kg_s']},{'-' if i < 3 else r['force_n'] * s},{moisture}"
            for i, (r, s) in enumerate(zip(rows, scatter, strict=True))
        ]
    number = 40 + 26
    cells = lines[number].split(",")
    assert (cells[0], cells[3]) == ("60.0", "26")
    lines[number] = f"{cells[0]},{cells[1]},{1.5 * float(cells[2])},{cells[3]}"
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines) + "\n")
    found = document(capsys, "calibrate", path, "--starts", "1", "--robust", "--free", "friction", *words)
    found = found["by_moisture"][-1] if "by_moisture" in found else found
    assert found["residual"]["outlier_rows"] == [number]
    assert any(f"row {number} lies" in note for note in found["notes"])


@pytest.mark.parametrize(("outliers", "end"), [(10, "10 lie more than"), (13, "10 and 3 more lie more than")])
def test_outliers_that_are_not_listed_are_counted(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, outliers: int, end: str
) -> None:
    rows = document(capsys, "predict", "--mass-flow", "2:20:1", "--plate-angle", "45:90:5", *PUBLISHED)["rows"]
    scatter = np.random.default_rng(3).normal(1.0, 0.002, len(rows))
    forces = [r["force_n"] * s * (1.5 if i < outliers else 1.0) for i, (r, s) in enumerate(zip(rows, scatter, strict=True))]
    lines = [f"{r['plate_angle_deg']},{r['mass_flow_kg_s']},{f}" for r, f in zip(rows, forces, strict=True)]
    path = tmp_path / "t.csv"
    path.write_text("\n".join(["plate_angle_deg,mass_flow_kg_s,force_n", *lines]) + "\n")
    found = document(capsys, "calibrate", path, "--starts", "1", "--robust", "--fix", "density=1100")
    assert len(found["residual"]["outlier_rows"]) == outliers
    said = [note for note in found["notes"] if f"1, 2, 3, 4, 5, 6, 7, 8, 9, {end}" in note]
    assert [note.partition("; ")[2] for note in said] == ["look at them."], "it is robust already"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--impact", "restitution"], "cannot represent the scale"),
        (["--starts", "0"], "--starts: is 0"),
        (["--effects", "magic"], "effect 'magic': unknown"),
        (["--free", "colour"], "--free: is 'colour'"),
        (["--fix", "restitution=0.5"], "restitution is not in this model"),
        (["--bounds", "friction=1"], "NAME=LOW:HIGH"),
        (["--bounds", "friction=1:0"], "the lower end first"),
        (["--plate-angle", "71"], "--plate-angle: is 71"),
        (["--by-moisture"], "without moisture_pct"),
        (["--response-scale", "-1"], "--response-scale: is -1"),
    ],
)
def test_calibrate_refuses_in_one_line(capsys: pytest.CaptureFixture[str], words: list[str], message: str) -> None:
    assert message in run(capsys, "calibrate", DATA / "bench_table.csv", *words, code=2)


def test_a_response_with_a_known_scale_takes_restitution(
    capsys: pytest.CaptureFixture[str], sweep_table: Path, tmp_path: Path
) -> None:
    lines = sweep_table.read_text().splitlines()
    table = tmp_path / "response.csv"
    passes = 400.0 * np.pi / 30.0 * 0.0541 / 0.18635
    body = [line.split(",") for line in lines[1:]]
    table.write_text(
        "plate_angle_deg,mass_flow_kg_s,response\n" + "\n".join(f"{a},{m},{250.0 * float(f) / passes}" for a, m, f in body) + "\n"
    )
    found = document(capsys, "calibrate", table, "--response-scale", "250", "--impact", "restitution", "--starts", "2")
    assert found["parameters"]["restitution"]["value"] == pytest.approx(0.63, rel=1e-3)


# self-calibrate


def test_self_calibrate_groups_by_load_and_writes_the_next_version(
    capsys: pytest.CaptureFixture[str], sweep_table: Path, known: Path, tmp_path: Path
) -> None:
    out = tmp_path / "next.yaml"
    found = document(capsys, "self-calibrate", sweep_table, "--params", known, "--sigma", "0.05", "--out", out)
    assert [g["group"] for g in found["groups"]] == ["6", "12", "20"]
    for group in found["groups"]:
        low, high = group["interval_kg_s"]
        assert low <= group["true_mass_flow_kg_s"] <= high
    update = found["updates"][0]
    assert update["parameters"]["friction"]["value"] == pytest.approx(0.25, abs=0.02)
    assert not update["scale"]["observable"]
    assert update["scale"]["ratio"] == pytest.approx(1.0, abs=1e-4)
    written = parameter_file.load(out)
    assert written.version == 2
    assert written.provenance["method"] == "closed loop"


def test_self_calibrate_alone_and_pooled(capsys: pytest.CaptureFixture[str], sweep_table: Path, known: Path) -> None:
    words = ("self-calibrate", sweep_table, "--params", known, "--sigma", "0.3", "--group-by", "mass_flow_kg_s")
    pooled, separate = document(capsys, *words), document(capsys, *words, "--separate")
    assert len(pooled["updates"]) == 1
    assert len(separate["updates"]) == 3
    narrow = pooled["updates"][0]["parameters"]["friction"]["sd"]
    assert all(narrow < u["parameters"]["friction"]["sd"] for u in separate["updates"])


def test_self_calibrate_in_words(capsys: pytest.CaptureFixture[str], sweep_table: Path, known: Path) -> None:
    text = run(capsys, "self-calibrate", sweep_table, "--params", known, "--sigma", "0.3", "--density", "1150:10")
    assert "scale (mass flow, density, impact gain) -> (a, a, 1/a)" in text
    assert "width narrowed" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "does not state the noise of its readings"),
        (["--sigma", "0"], "--sigma: is 0"),
        (["--sigma", "inf"], "--sigma: is inf"),
        (["--sigma", "1", "--model-error", "-1"], "--model-error: is -1"),
        (["--sigma", "1", "--model-error", "nan"], "--model-error: is nan"),
        (["--sigma", "1", "--out", "nowhere/x.yaml"], "nowhere/x.yaml: there is no folder"),
        (["--sigma", "1", "--group-by", "colour"], "colour is not a column"),
        (["--sigma", "1", "--group-by", "force_n"], "fewer than two plate angles"),
        (["--sigma", "1", "--density", "1100"], "KG_M3:SD"),
        (["--sigma", "1", "--separate", "--out", "x.yaml"], "given with --separate"),
    ],
)
def test_self_calibrate_refuses_in_one_line(
    capsys: pytest.CaptureFixture[str], sweep_table: Path, known: Path, words: list[str], message: str
) -> None:
    assert message in run(capsys, "self-calibrate", sweep_table, "--params", known, *words, code=2)


def test_self_calibrate_takes_the_rows_at_their_times(capsys: pytest.CaptureFixture[str], tmp_path: Path, known: Path) -> None:
    """A flow that rises by a quarter in 150 s, as it was measured and with its rows exchanged; without times 20 % are stated."""
    angles, times = np.tile([70, 40, 50, 60, 70, 80, 90, 70], 2), 10.0 * np.arange(16)
    flows = ",".join(f"{8.0 * (1.0 + t / 600.0):.6g}" for t in times)
    each = document(capsys, "predict", "--mass-flow", flows, "--plate-angle", "40:90:10", *PUBLISHED)["rows"]
    forces = np.array([row["force_n"] for row in each]).reshape(16, 6)[np.arange(16), (angles - 40) // 10]
    found = []
    for name, order in (("in order", np.arange(16)), ("mixed", np.random.default_rng(2).permutation(16))):
        path = tmp_path / f"{name}.csv"
        rows = "".join(f"{angles[i]},{forces[i]:.8g},{times[i]:g}\n" for i in order)
        path.write_text(f"plate_angle_deg,force_n,time_s\n{rows}")
        words = ("self-calibrate", path, "--params", known, "--sigma", "0.3", "--flow", "linear")
        found += document(capsys, *words)["groups"]
    ordered, mixed = found
    assert mixed["mass_flow_kg_s"] == pytest.approx(ordered["mass_flow_kg_s"], rel=1e-6)
    assert ordered["mass_flow_kg_s"] == pytest.approx(9.0, rel=0.02)
    assert ordered["std_dev_kg_s"] < 0.15 * ordered["mass_flow_kg_s"]


@pytest.mark.parametrize("unit_n", [1.0, 4.448])
def test_calibrate_says_where_repeated_rows_are_no_repetitions(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, unit_n: float
) -> None:
    """Each row once more in pounds-force."""
    rows = document(capsys, "predict", "--mass-flow", "6,12,18", "--plate-angle", "45:85:10", *PUBLISHED)["rows"]
    rng = np.random.default_rng(7)
    lines = [
        f"{r['plate_angle_deg']},{r['mass_flow_kg_s']},{r['force_n'] * (1.0 + 0.01 * rng.standard_normal()) / unit:.6g}"
        for r in rows
        for unit in (1.0, unit_n)
    ]
    path = tmp_path / "t.csv"
    path.write_text("\n".join(["plate_angle_deg,mass_flow_kg_s,force_n", *lines, ""]))
    notes = "\n".join(document(capsys, "calibrate", path, "--starts", "2")["notes"])
    assert ("no repetitions" in notes) is (unit_n > 1.0)


@pytest.mark.parametrize(
    ("sigma", "asked"),
    [(0.02, "repeated rows scatter by"), (0.6, ""), (20.0, "times what the fit misses the rows by: is it in the unit")],
)
def test_calibrate_asks_about_a_sigma_that_the_rows_do_not_show(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, sigma: float, asked: str
) -> None:
    rows = document(capsys, "predict", "--mass-flow", "6,12,18", "--plate-angle", "45:85:10", *PUBLISHED)["rows"]
    rng = np.random.default_rng(6)
    lines = [
        f"{r['plate_angle_deg']},{r['mass_flow_kg_s']},{r['force_n'] + 0.6 * rng.standard_normal():.6g},{sigma}"
        for r in rows
        for _ in range(2)
    ]
    path = tmp_path / "t.csv"
    path.write_text("\n".join(["plate_angle_deg,mass_flow_kg_s,force_n,sigma", *lines, ""]))
    sentences = "\n".join(document(capsys, "calibrate", path, "--starts", "2")["notes"])
    assert (asked in sentences) if asked else ("sigma" not in sentences)


@pytest.mark.parametrize(("times", "named"), [(1, False), (2, True)])
def test_calibrate_names_rows_that_are_copies(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, sweep_table: Path, times: int, named: bool
) -> None:
    header, *rows = sweep_table.read_text().splitlines()
    path = tmp_path / "pasted.csv"
    path.write_text("\n".join([header, *rows * times]) + "\n")
    notes = document(capsys, "calibrate", path, "--starts", "1")["notes"]
    assert any(f"{2 * len(rows)} of {2 * len(rows)} rows repeat another reading" in note for note in notes) == named


# the unit of a reading


def test_exchange_coefficients_of_a_file_that_names_no_unit_hold_that_of_the_response(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    grain = "friction: 0.3\ndensity: 1100\nshape_ratio: 2\nk1: 3\nk2: 50\n"
    path, table = tmp_path / "p.yaml", tmp_path / "t.csv"
    path.write_text(grain + "response_unit: mV\n")
    assert main(["predict", "--mass-flow", "7", "--params", str(path), "--json"]) == 0
    out, err = capsys.readouterr()
    assert "in the unit 'mV' of the parameters, not in kg m/s and N" in err
    reading = json.loads(out)["rows"][0]["paddle_momentum_kg_m_s"]
    table.write_text(f"plate_angle_deg,response\n70,{reading!r}\n")
    for unit in ("", "response_unit: mV\n", "response_unit: response\n"):
        path.write_text(grain + unit)
        rows = document(capsys, "estimate", table, "--params", path)["rows"]
        assert rows[0]["mass_flow_kg_s"] == pytest.approx(7.0, rel=1e-9)
    path.write_text(grain + "response_unit: N\n")
    assert "parameters in 'response'" in run(capsys, "estimate", table, "--params", path, code=2)
    path.write_text("friction: 0.3\ndensity: 1100\nshape_ratio: 2\nrestitution: 0.5\n")
    assert "parameters in 'response'" in run(capsys, "estimate", table, "--params", path, code=2)
    path.write_text(grain + "response_unit: mV\n")
    table.write_text("plate_angle_deg,force_n\n70,50\n")
    assert "parameters in 'N'" in run(capsys, "estimate", table, "--params", path, code=2)
