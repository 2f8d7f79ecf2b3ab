"""Pictures: each drawn from real records, its lines those of the numbers behind it, its file a picture."""

from __future__ import annotations

import csv
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.seconds import measured_second
from yieldmon.cli import main as cli
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.service.logs.recorded import read_seconds
from yieldmon.service.logs.tables import open_table
from yieldmon.service.storage.batch import Batch, Load, ParameterVersion, Ticket
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

pytest.importorskip("matplotlib", reason="needs the plot extra")

from yieldmon.plots import errors, published, sensitivity

DATA = Path(__file__).parents[1] / "data"
START_S = 1_760_000_000


def second(number: int) -> SecondRow:
    """A second of a record with a sweep from the 20th to the 39th."""
    sweeping = 20 <= number < 40
    flow = 10.0 + np.sin(number / 9.0)
    return measured_second(
        number,
        START_S + number + 0.1,
        flow,
        mass_flow_kg_s=None if number < 5 else flow,
        std_dev_kg_s=None if number < 5 else 0.2,
        load_kg=10.0 * number,
        total_kg=10.0 * number,
        force_n=60.0 + number,
        plate_angle_deg=40.0 + 5.0 * (number % 4) if sweeping else 70.0,
        moisture_pct=15.0,
        sweep_id=int(sweeping),
        sweep_step=number % 4 if sweeping else -1,
        usable_for_calibration=int(sweeping),
        longitude_deg=-88.0,
        ground_speed_m_s=1.5,
    )


ROWS = [second(number) for number in range(1, 61)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record as table and as store, and its truth."""
    place = tmp_path_factory.mktemp("plots")
    with open_table(str(place / "r.csv")) as writer:
        for row in ROWS:
            writer.write(row)
    with (place / "truth.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time_s", "mass_flow_kg_s", "total_mass_kg"])
        writer.writerows([k, 10.0, 10.0 * k] for k in range(1, 62))
    corn = yaml.safe_load((DATA.parents[1] / "config/parameters/corn.yaml").read_text(encoding="utf-8"))
    versions = tuple(
        ParameterVersion(k, START_S + 600.0 * k, origin, {**corn, "friction": 0.19 + 0.01 * k, "version": k})
        for k, origin in enumerate(("file", "sweep", "ticket"), 1)
    )
    load = Load(1, "north", "corn", START_S, START_S + 50.0, 500.0, None)
    ticket = Ticket(START_S + 99.0, 1, 1, 490.0, 500.0)
    with Store(place / "r.sqlite") as store:
        store.commit([Batch(1, START_S, {}, tuple(ROWS), (load,), (), versions, (), (ticket,))])
    return place


PICTURES = {
    "flow of a table": ["flow", "{folder}/r.csv", "--truth", "{folder}/truth.csv"],
    "flow of a store with a ticket": ["flow", "{folder}/r.sqlite"],
    "errors": ["errors", "{folder}/r.csv", "--truth", "{folder}/truth.csv"],
    "sweeps": ["sweeps", "{folder}/r.csv"],
    "parameters": ["parameters", "{folder}/r.sqlite"],
    "curves alone": ["curves", "--mass-flow", "2", "10", "--plate-angle", "40", "70"],
    "curves with readings": ["curves", str(DATA / "corn_facility.csv")],
    "residuals": ["residuals", str(DATA / "corn_facility.csv")],
    "sensitivity": ["sensitivity"],
    "published": ["published", str(DATA / "published_tables.yaml")],
}


@pytest.mark.parametrize("words", PICTURES.values(), ids=PICTURES)
def test_every_picture(words, folder, tmp_path):
    out = tmp_path / "p.svg"
    assert cli.main(["plot", *(word.format(folder=folder) for word in words), "--out", str(out)]) == 0
    root = ET.fromstring(out.read_text(encoding="utf-8"))
    drawn = [node for node in root.iter("{http://www.w3.org/2000/svg}path") if node.get("d")]
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert len(drawn) > 10


def test_png_and_the_same_svg_twice(tmp_path):
    words = ["plot", "sensitivity", "--plate-angle", "60", "--out"]
    for name in ("a.png", "a.svg", "b.svg"):
        assert cli.main([*words, str(tmp_path / name)]) == 0
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


WRONG = [
    (["sensitivity", "--out", "x.pdf"], "yieldmon: --out: is x.pdf; expected a name that ends in .png or .svg"),
    (["flow", "gone.csv", "--out", "x.png"], "yieldmon: gone.csv: no such file"),
    (["flow", "gone.txt", "--out", "x.png"], "yieldmon: gone.txt: unknown kind of record '.txt'"),
    (["sweeps", "{folder}/none.csv", "--out", "x.png"], "none.csv: holds no seconds"),
    (
        ["flow", "{folder}/r.csv", "--truth", str(DATA / "bench_table.csv"), "--out", "x.png"],
        "csv: is not a truth table: 'time_s'",
    ),
    (["errors", "{folder}/r.csv", "--truth", "{folder}/truth.csv", "--bands", "3", "2", "--out", "x.png"], "two or more rising"),
    (["curves", str(DATA / "bench_table.csv"), "--out", "x.png"], "holds response, but the parameters are in the unit 'N'"),
    (["curves", "--elevator-speed", "-5", "--out", "x.png"], "--elevator-speed: is -5; expected above 0 rpm"),
    (["curves", "--mass-flow", "1000", "--out", "x.png"], "a full paddle"),
    (["curves", "--moisture", "nan", "--out", "x.png"], "--moisture: is nan"),
    (["sensitivity", "--plate-angle", "nan", "--out", "x.png"], "--plate-angle: is nan"),
    (["sensitivity", "--out", "nowhere/x.png"], "nowhere/x.png: there is no folder"),
    (["published", str(DATA.parents[1] / "config/parameters/corn.yaml"), "--out", "x.png"], "lacks 'generated_momentum'"),
]


@pytest.mark.parametrize(("words", "line"), WRONG)
def test_one_line_for_what_cannot_be_drawn(words, line, folder, capsys):
    (folder / "none.csv").write_text((folder / "r.csv").read_text(encoding="utf-8").splitlines()[0] + "\n", encoding="utf-8")
    assert cli.main(["plot", *(word.format(folder=folder) for word in words)]) == 2
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1


def test_without_matplotlib_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    assert cli.main(["plot", "sensitivity", "--out", str(tmp_path / "x.png")]) == 1
    said = capsys.readouterr().err
    assert said == "yieldmon: needs matplotlib, which is not installed; pip install 'yieldmon[plot]'\n"


def test_sensitivity_is_that_of_single_forward_runs():
    machine = Machine()
    values = np.array([0.1, 0.5, 2.0])
    grid = sensitivity.forces_n(machine, "friction", values, np.radians(70.0))
    for row, flow in zip(grid, sensitivity.FLOWS_KG_S, strict=True):
        for force, friction in zip(row, values, strict=True):
            conditions = Conditions(np.radians(70.0), machine.nominal_elevator_speed_rad_s, mass_flow_kg_s=flow)
            alone = ForwardModel(machine).force(conditions, {**sensitivity.TYPICAL, "friction": friction})
            assert force == pytest.approx(float(alone))


def test_the_sensitivity_study_is_the_published_one():
    theirs = yaml.safe_load((DATA / "published_tables.yaml").read_text(encoding="utf-8"))["sensitivity_study"]
    ours = {"friction": "friction", "restitution": "restitution", "density": "density_kg_m3", "shape_ratio": "shape_ratio"}
    for name, key in ours.items():
        assert sensitivity.TYPICAL[name] == theirs["typical"][key]
        assert list(sensitivity.RANGES[name]) == theirs["ranges"][key]
    assert (sensitivity.FLOWS_KG_S[0], sensitivity.FLOWS_KG_S[-1]) == (2.0, 26.0)


def test_published_momentum_beside_ours():
    theirs = yaml.safe_load((DATA / "published_tables.yaml").read_text(encoding="utf-8"))
    angles, flows, printed, ours = published.momentum_table(theirs, Machine())
    assert (len(flows), len(angles)) == printed.shape == ours.shape == (8, 11)
    assert np.abs(ours / printed - 1.0).max() < 0.01


def test_errors_count_every_second_with_a_truth():
    true = np.array([2.0, 2.0, 6.0, np.nan, 6.0])
    measured = np.array([2.2, 1.8, 6.3, 5.0, np.nan])
    figure = errors.draw(true, measured, np.array([1.0, 5.0, 9.0]))
    assert [text.get_text() for text in figure.axes[0].texts] == ["n=2", "n=1"]


@pytest.mark.parametrize("ending", ["csv", "jsonl", "parquet"])
def test_a_record_reads_back_as_it_was(ending, tmp_path):
    if ending == "parquet":
        pytest.importorskip("pyarrow", reason="needs the parquet extra")
    path = tmp_path / f"r.{ending}"
    rows = [replace(row, faults="SensorMissing SpeedMissing") if row.number == 3 else row for row in ROWS]
    with open_table(str(path)) as writer:
        for row in rows:
            writer.write(row)
    assert read_seconds(path) == rows
