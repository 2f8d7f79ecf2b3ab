"""A store's sweeps as a table, and the diagnosis on it: sweeps from the virtual combine's physics, not the model's."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.in_process import program
from tests.plant_sweeps import MACHINE, NONE, STRONG, Effects, shown_force, sweep_windows
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file, table
from yieldmon.service.logs import sweep_table
from yieldmon.service.storage import schema
from yieldmon.service.storage.batch import Batch, ParameterVersion
from yieldmon.service.storage.rows import second_row
from yieldmon.service.storage.store import Store

SHIPPED = parameter_file.load()
ANGLES_DEG = (40.0, 45.0, 50.0, 55.0, 60.0, 65.0, 75.0, 80.0, 85.0, 90.0)
FLOWS_KG_S = (8.0, 12.0, 16.0, 6.0, 14.0, 10.0)


def fill(path: Path, effects: Effects, sweeps: int, angles_deg: tuple[float, ...] = ANGLES_DEG, origin: str = "file") -> Path:
    """A store with whole sweeps, each at a flow of its own, and the parameters that the daemon began with."""
    force = shown_force(MACHINE, effects)
    parameters = ParameterVersion(1, 0.0, origin, parameter_file.to_document(SHIPPED))
    learnt = ParameterVersion(2, 1.0, "sweep", parameter_file.to_document(SHIPPED) | {"version": 2, "friction": 0.9})
    with Store(path) as store:
        number = 0
        for i in range(sweeps):
            flow = FLOWS_KG_S[i % len(FLOWS_KG_S)]
            windows = sweep_windows(
                MACHINE, force, flow_kg_s=flow, seed=i, start_s=1800.0 * i, sweep_id=i + 1, angles_deg=angles_deg
            )
            rows = [second_row(number + n, window) for n, window in enumerate(windows, 1)]
            number += len(rows)
            store.commit([Batch(i + 1, rows[-1].time_s, {}, tuple(rows), parameter_versions=(parameters, learnt))])
        if not sweeps:
            store.commit([Batch(1, 0.0, {}, parameter_versions=(parameters, learnt))])
    return path


def uncertain(share: float) -> ParameterSet:
    """The shipped parameters with density and restitution known to this share only."""
    names = ("density", "restitution")
    return ParameterSet(SHIPPED.values, names, np.diag([(share * SHIPPED.values[name]) ** 2 for name in names]))


@pytest.fixture(scope="module")
def strong(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill(tmp_path_factory.mktemp("strong") / "yieldmon.sqlite", STRONG, 18)


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill(tmp_path_factory.mktemp("clean") / "yieldmon.db", NONE, 18)


def test_rows_are_the_plants_forces_at_the_flows_named(clean: Path) -> None:
    found = sweep_table.read(clean, MACHINE, SHIPPED)
    columns = found.table.columns
    assert found.sweeps == 18
    # Ten angles and four of the six visits home: the first and the last have none before or after them.
    assert len(found.table) == 18 * 14
    assert sorted(set(columns["plate_angle_deg"])) == sorted({*ANGLES_DEG, 70.0})
    true = shown_force(MACHINE, NONE)(columns["mass_flow_kg_s"], np.radians(columns["plate_angle_deg"]))
    off = (columns["force_n"] - true) / columns["sigma"]
    # The speed is carried to a step of 2 %, here 400 rpm itself.
    assert set(columns["elevator_speed_rpm"]) == {400.0}
    assert abs(float(np.mean(off))) < 0.25
    assert 0.8 < float(np.sqrt(np.mean(off**2))) < 1.25


def test_a_visits_sigma_is_that_of_its_force(clean: Path) -> None:
    """sigma^2 is linear in force^2 to rounding: two constants for all visits."""
    columns = sweep_table.read(clean, MACHINE, SHIPPED).table.columns
    square, variance = columns["force_n"] ** 2, columns["sigma"] ** 2
    slope, constant = np.polyfit(square, variance, 1)
    np.testing.assert_allclose(variance, constant + slope * square, rtol=1e-9)
    assert slope > 0.0


def test_flows_come_in_steps_that_rows_can_share(clean: Path) -> None:
    flows = np.unique(sweep_table.read(clean, MACHINE, SHIPPED).table.columns["mass_flow_kg_s"])
    assert np.diff(np.log(flows)).min() > 0.09


def test_the_newest_sweeps_alone(clean: Path) -> None:
    found = sweep_table.read(clean, MACHINE, SHIPPED, last=3)
    assert set(found.table.text["trial"]) == {"16", "17", "18"}


def test_the_table_as_csv_is_the_table(clean: Path, tmp_path: Path) -> None:
    found = sweep_table.read(clean, MACHINE, SHIPPED)
    (tmp_path / "t.csv").write_text(found.text, encoding="utf-8")
    again = table.load(tmp_path / "t.csv")
    assert again.sha256 == found.table.sha256
    assert again.text["trial"] == found.table.text["trial"]
    for name, values in found.table.columns.items():
        assert again.columns[name] == pytest.approx(values, rel=1e-5, nan_ok=True)


def test_flow_is_that_of_the_parameters_given_not_of_those_after_sweeps(clean: Path) -> None:
    assert sweep_table.given_parameters(clean).values == SHIPPED.values


def test_the_scale_is_as_uncertain_as_the_parameters(clean: Path) -> None:
    assert 0.0 < sweep_table.read(clean, MACHINE, SHIPPED).scale_sd < 0.02
    assert 0.03 < sweep_table.read(clean, MACHINE, uncertain(0.1)).scale_sd < 0.2


def test_a_store_is_read_while_a_daemon_writes_it(tmp_path: Path) -> None:
    path = fill(tmp_path / "s.sqlite", NONE, 6)
    with Store(path) as writer:
        writer.commit([Batch(100, 0.0, {})])
        assert path.with_name("s.sqlite-wal").stat().st_size > 0
        found = sweep_table.read(path, MACHINE, SHIPPED)
        writer.commit([Batch(101, 0.0, {})])
    assert found.sweeps == 6


def test_reading_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    path = fill(tmp_path / "s.sqlite", NONE, 6)
    before = {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()}
    sweep_table.read(path, MACHINE, SHIPPED)
    assert {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()} == before


def test_a_store_of_the_version_before_is_read(tmp_path: Path) -> None:
    now, path = fill(tmp_path / "now.sqlite", NONE, 6), tmp_path / "s.sqlite"
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        for step in schema.MIGRATIONS[:2]:
            database.executescript(step)
        database.execute(f"PRAGMA application_id = {schema.APPLICATION_ID}")
        database.execute("PRAGMA user_version = 2")
        database.execute("ATTACH ? AS now", (str(now),))
        for table in ("second", "parameter_set"):
            columns = ", ".join(row[1] for row in database.execute(f"PRAGMA main.table_info({table})"))
            database.execute(f"INSERT INTO main.{table} ({columns}) SELECT {columns} FROM now.{table}")
    assert sweep_table.read(path, MACHINE, SHIPPED).sweeps == 6
    assert sweep_table.given_parameters(path).values == SHIPPED.values


def write_text(path: Path) -> None:
    path.write_text("plate_angle_deg,force_n\n" * 100, encoding="utf-8")


def write_foreign(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE t (a)")


def write_newer(path: Path) -> None:
    fill(path, NONE, 0)
    with closing(sqlite3.connect(path)) as database:
        database.execute(f"PRAGMA user_version = {schema.VERSION + 1}")


def nothing(path: Path) -> None:
    pass


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (nothing, "no such file"),
        (write_text, "file is not a database"),
        (write_foreign, "another program"),
        (write_newer, f"schema version {schema.VERSION + 1}"),
        (lambda path: fill(path, NONE, 0), "holds no sweep"),
        (lambda path: fill(path, NONE, 5, (60.0, 80.0)), "at 2 plate angles (60, 80 deg); expected at least 4"),
        (lambda path: fill(path, NONE, 1, origin="sweep"), "holds no parameters that came from a file"),
    ],
    ids=["missing", "text", "foreign", "newer", "no sweep", "few angles", "no parameters"],
)
def test_what_cannot_be_used_gets_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], make, problem: str) -> None:
    path = tmp_path / "s.sqlite"
    make(path)
    assert main(["diagnose", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert problem in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["{store}", "--sweeps", "0"], "--sweeps: is 0; expected a whole number from 1"),
        (["{csv}", "--sweeps", "3"], "is not a store"),
        (["{csv}", "--table", "t.csv"], "is not a store"),
    ],
)
def test_options_that_do_not_fit(
    clean: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], problem: str
) -> None:
    names = {"store": str(clean), "csv": str(tmp_path / "d.csv")}
    assert main(["diagnose", *(argument.format(**names) for argument in arguments)]) == 2
    assert problem in capsys.readouterr().err


def test_damaged_pages_get_one_line(tmp_path: Path) -> None:
    path = fill(tmp_path / "s.sqlite", NONE, 6)
    content = bytearray(path.read_bytes())
    content[4096:] = b"\xff" * (len(content) - 4096)
    path.write_bytes(bytes(content))
    with pytest.raises(InputError, match="expected a daemon's store"):
        sweep_table.read(path, MACHINE, SHIPPED)


@pytest.fixture(scope="module")
def diagnosed(strong: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], str]:
    """Folder with the adopted parameters, from ones that know the scale to 5 %; the document; what is said beside it."""
    folder = tmp_path_factory.mktemp("diagnosed")
    parameter_file.save(uncertain(0.05), folder / "wide.yaml")
    options = ("--params", folder / "wide.yaml", "--adopt", folder / "new.yaml", "--plan", folder / "plan.csv")
    done = program("yieldmon.cli.main", "diagnose", strong, "--json", *options)
    assert done.returncode == 0, done.stderr
    return folder, json.loads(done.stdout), done.stderr


def test_the_effect_is_named_adopted_and_kept_with_what_was_known(diagnosed: tuple[Path, dict[str, Any], str]) -> None:
    """Friction of 0.2 on the plate, from 18 sweeps; the model's own gravity stays and is not found anew."""
    folder, found, reported = diagnosed
    out = folder / "undone.yaml"
    for path in folder.glob("new*"):
        shutil.copy(path, folder / path.name.replace("new", "undone"))
    assert found["verdict"] == "effect"
    named = found["effects"][0]
    assert "plate_friction" in {named["name"], *named["equivalent"]}
    assert "gravity" not in {effect["name"] for effect in found["effects"]}
    assert found["gap"]["held_out"]["after"]["rms"] < found["gap"]["held_out"]["before"]["rms"]
    adopted = parameter_file.load(out)
    assert set(adopted.effects) == {"gravity", *(effect["name"] for effect in found["effects"])}
    assert adopted.provenance["parent_version"] == "1"
    assert "scale of flow and gain" in reported
    assert main(["diagnose", "--rollback", str(out)]) == 0
    assert parameter_file.load(out).values == SHIPPED.values


def test_the_parameters_adopted_are_no_surer_of_the_scale_than_their_parents(
    strong: Path, diagnosed: tuple[Path, dict[str, Any], str]
) -> None:
    adopted = parameter_file.load(diagnosed[0] / "new.yaml")
    scale_sd = sweep_table.read(strong, MACHINE, uncertain(0.05)).scale_sd
    assert adopted.standard_deviation("density") / adopted.values["density"] >= scale_sd


@pytest.mark.parametrize(("machine", "asked"), [(MACHINE.name, False), ("combine", True)])
def test_nothing_is_named_in_a_machine_that_the_model_knows(
    clean: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], machine: str, asked: bool
) -> None:
    """machine: for which the parameters say that they were made."""
    parameter_file.save(replace(SHIPPED, provenance={**SHIPPED.provenance, "machine": machine}), tmp_path / "p.yaml")
    assert main(["diagnose", str(clean), "--json", "--params", str(tmp_path / "p.yaml")]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["verdict"] == "none"
    question = "made for another machine (the name combine, here sprocket-8): is --machine the one that measured these sweeps?"
    assert (question in err) == asked


@pytest.mark.parametrize(
    ("harm", "look", "said"),
    [
        (
            "UPDATE second SET force_n = force_n + 1 WHERE number = 40",
            lambda path: sweep_table.read(path, MACHINE, SHIPPED),
            "second 40 is damaged",
        ),
        ("UPDATE parameter_set SET origin = 'File'", sweep_table.given_parameters, "parameter_set '1' is damaged"),
    ],
    ids=["a force", "a parameter set"],
)
def test_what_is_not_as_it_was_written_is_refused(clean: Path, tmp_path: Path, harm: str, look: Any, said: str) -> None:
    path = tmp_path / "s.sqlite"
    path.write_bytes(clean.read_bytes())
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(harm)
    with pytest.raises(InputError, match=said):
        look(path)
