"""What machines share is the model's, what one has is its own; sweeps of a dataset are those of a store."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.plant_sweeps import MACHINE, NONE, STRONG, Effects, shown_force, sweep_windows
from tests.schema_check import problems
from yieldmon.cli.main import main
from yieldmon.discrepancy.policy import Policy
from yieldmon.errors import InputError
from yieldmon.files import machine_file, parameter_file
from yieldmon.fleet import tables
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.diagnosis import FleetDiagnosis, MachineSweeps, MachineVerdict, Named, SharedVerdict, diagnose, sweeps_of
from yieldmon.physics.machine import Machine
from yieldmon.service.logs import sweep_table
from yieldmon.service.storage.batch import Batch, ParameterVersion
from yieldmon.service.storage.rows import second_row
from yieldmon.service.storage.store import Store

SHIPPED = parameter_file.load()
ALIKE_ONLY = Policy(most_effects=0)
"""Machines against each other, without the search for what all of them show, which takes most of the time."""


def sweeps(name: str, effects: Effects, seed: int, machine: Machine = MACHINE) -> MachineSweeps:
    """A machine's day of six sweeps, by the virtual combine's physics."""
    force = shown_force(MACHINE, effects)
    windows = [
        window
        for sweep in range(6)
        for window in sweep_windows(
            MACHINE, force, flow_kg_s=6.0 + 2.0 * sweep, seed=100 * seed + sweep, start_s=1800.0 * sweep, sweep_id=sweep + 1
        )
    ]
    return MachineSweeps(name, machine, SHIPPED, (tuple(second_row(number, w) for number, w in enumerate(windows, 1)),))


def named(verdicts: tuple[MachineVerdict, ...]) -> dict[str, list[str]]:
    return {v.name: [e for item in v.named for e in (item.effect, *item.equivalent)] for v in verdicts if v.verdict != "none"}


def test_what_one_machine_shows_beside_the_others_is_its_own() -> None:
    fleet = [sweeps(f"m{i}", STRONG if i == 2 else NONE, seed=i) for i in range(5)]
    found = diagnose(fleet, ALIKE_ONLY)
    assert [v.name for v in found.machines] == ["m0", "m1", "m2", "m3", "m4"]
    assert list(named(found.machines)) == ["m2"]
    assert "plate_friction" in named(found.machines)["m2"]
    [effect] = found.machines[2].named
    assert 0.5 < effect.confidence < 0.999, "by the evidence of those that are tied over that of all, not that it differs alone"


def test_what_all_machines_show_is_none_ones_own() -> None:
    found = diagnose([sweeps(f"m{i}", STRONG, seed=10 + i) for i in range(4)], ALIKE_ONLY)
    assert named(found.machines) == {}
    assert (found.shared, found.model) == ("unknown", ())


def test_machines_that_the_model_describes_share_no_effect() -> None:
    assert diagnose([sweeps(f"m{i}", NONE, seed=60 + i) for i in range(3)], ALIKE_ONLY).shared == "none"


LEVER = Named("lever_arm", ("paddle_wear",), 0.6)
CROWDED = Named("plate_friction", ("a", "b", "c", "d", "e"), 0.8)


@pytest.mark.parametrize(
    ("shared", "model", "candidates", "said"),
    [
        ("effect", (LEVER, CROWDED), (), "the model lacks lever_arm or paddle_wear\nthe model lacks one of 6 effects"),
        ("unknown", (), (LEVER,), "too uncertain to name; the nearest: lever_arm or paddle_wear\n"),
        ("unknown", (), (), "too uncertain to name; no known effect explains it\n"),
        ("none", (), (), "no effect is shared by all machines\n"),
        ("not compared", (), (), "not known whether machines share an effect"),
    ],
)
def test_what_is_said_of_all_machines(
    shared: SharedVerdict, model: tuple[Named, ...], candidates: tuple[Named, ...], said: str,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    found = FleetDiagnosis(shared, model, candidates, (MachineVerdict("m0", "none"),))
    monkeypatch.setattr("yieldmon.cli._fleet.diagnose.sweeps_of", lambda _dataset: ())
    monkeypatch.setattr("yieldmon.cli._fleet.diagnose.diagnose", lambda _machines, each: found)
    assert main(["fleet", "diagnose", "season", "--workers", "1"]) == 0
    assert said in capsys.readouterr().out
    assert main(["fleet", "diagnose", "season", "--workers", "1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert problems(document, "fleet-diagnose") == []
    assert (document["shared"], len(document["model"]), len(document["candidates"])) == (shared, len(model), len(candidates))


@pytest.mark.parametrize(
    ("verdicts", "said"),
    [
        (("none", "effect"), "1 of 2 machines show no effect of their own"),
        (("none", "none", "has 0 visits"), "2 of 2 compared machines show no effect of their own"),
        (("has 0 visits", "has 0 visits"), None),
    ],
)
def test_machines_that_were_not_compared_are_not_counted(
    verdicts: tuple[str, ...], said: str | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = FleetDiagnosis("none", (), (), tuple(MachineVerdict(f"m{i}", verdict) for i, verdict in enumerate(verdicts)))
    monkeypatch.setattr("yieldmon.cli._fleet.diagnose.sweeps_of", lambda _dataset: ())
    monkeypatch.setattr("yieldmon.cli._fleet.diagnose.diagnose", lambda _machines, each: found)
    main(["fleet", "diagnose", "season", "--workers", "1"])
    shown = [line for line in capsys.readouterr().out.splitlines() if "of their own" in line]
    assert shown == ([said] if said else [])


def test_a_gain_that_the_tickets_know_is_no_effect() -> None:
    """Half the machines' cells show a tenth more, and their parameters say so."""
    fleet = []
    for i in range(4):
        machine = sweeps(f"m{i}", NONE, seed=20 + i)
        if i % 2:
            gain = {"restitution": 1.1 * (1.0 + SHIPPED.values["restitution"]) - 1.0}
            rows = tuple(
                replace(row, force_n=1.1 * row.force_n, force_std_dev_n=1.1 * row.force_std_dev_n) for row in machine.days[0]
            )
            machine = replace(machine, parameters=replace(SHIPPED, values={**SHIPPED.values, **gain}), days=(rows,))
        fleet.append(machine)
    assert named(diagnose(fleet, ALIKE_ONLY).machines) == {}


def test_machines_of_another_geometry_and_with_too_few_sweeps_are_not_judged() -> None:
    other = replace(MACHINE, plate_length_m=0.9 * MACHINE.plate_length_m)
    fleet = [sweeps(f"m{i}", NONE, seed=30 + i) for i in range(3)]
    fleet += [sweeps("other", NONE, seed=33, machine=other), replace(fleet[0], name="short", days=(fleet[0].days[0][:60],))]
    found = diagnose(fleet, ALIKE_ONLY)
    said = {v.name: (v.verdict, v.judged) for v in found.machines}
    assert said["other"] == ("fewer than 3 machines of its geometry", False)
    assert said["short"] == ("has 18 visits away from home at 5 angles, needs 40 at 3", False)
    assert [said[f"m{i}"] for i in range(3)] == [("none", True)] * 3
    assert found.shared == "none"
    assert diagnose(fleet[:2], ALIKE_ONLY).shared == diagnose([], ALIKE_ONLY).shared == "not compared"


@pytest.mark.slow
def test_what_all_machines_show_is_named_as_the_models() -> None:
    [found] = diagnose([sweeps(f"m{i}", STRONG, seed=40 + i) for i in range(3)]).model
    assert found.may_be("plate_friction")
    assert found.values
    assert all(np.isfinite(value) for value in found.values.values())


def rows_of(day: int, seed: int) -> list:
    force = shown_force(MACHINE, NONE)
    angles = (40.0, 50.0, 60.0, 80.0, 90.0)
    found: list = []
    for sweep in range(3):
        windows = sweep_windows(
            MACHINE, force, flow_kg_s=8.0 + 2.0 * sweep, seed=seed + sweep, start_s=1e5 * day + 1800.0 * sweep,
            sweep_id=sweep + 1, angles_deg=angles,
        )  # fmt: skip
        found += [second_row(len(found) + n, window) for n, window in enumerate(windows, 1)]
    return found


def commit(dataset: Dataset, token: str, name: str, rows: list) -> None:
    with dataset.workspace() as folder:
        output = folder / "output"
        output.mkdir()
        columns = {field: [getattr(row, field) for row in rows] for field in rows[0].__dataclass_fields__}
        pq.write_table(pa.table(columns), output / "records.parquet")
        for table in (tables.LOADS, tables.SWEEPS, tables.FAULTS, tables.PARAMETERS):
            tables.write(table, [], output / f"{table}.parquet")
        known = {
            "machine_document": json.dumps(machine_file.to_document(MACHINE)),
            "parameters_document": json.dumps(parameter_file.to_document(SHIPPED)),
        }
        tables.write(tables.PROVENANCE, [known], output / "provenance.parquet")
        dataset.commit(name, output, {"key": name, "poisoned": []}, token)


def test_sweeps_of_a_dataset_are_those_of_a_store(tmp_path: Path) -> None:
    dataset = Dataset(str(tmp_path / "season"))
    token = dataset.begin()
    for machine in range(3):
        for day in range(2):
            commit(dataset, token, f"machine=m{machine}/day={day}", rows_of(day, 10 * machine + 100 * day))
    found = sweeps_of(str(tmp_path / "season"))
    assert [machine.name for machine in found] == ["m0", "m1", "m2"]
    assert found[0].machine.plate_length_m == MACHINE.plate_length_m
    first = rows_of(0, 0)
    with Store(tmp_path / "s.sqlite") as store:
        document = ParameterVersion(1, 0.0, "file", parameter_file.to_document(SHIPPED))
        store.commit([Batch(1, first[-1].time_s, {}, tuple(first), parameter_versions=(document,))])
    of_store = sweep_table.read(tmp_path / "s.sqlite", MACHINE, SHIPPED)
    one_day = sweep_table.of_seconds(found[0].days[:1], "m0", MACHINE, SHIPPED)
    assert one_day.text == of_store.text
    # Numbers of sweeps begin anew each day: they are other sweeps all the same.
    assert sweep_table.of_seconds(found[0].days, "m0", MACHINE, SHIPPED).sweeps == 6


def test_a_dataset_without_sweeps_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset = Dataset(str(tmp_path / "season"))
    commit(dataset, dataset.begin(), "machine=m/day=1", rows_of(0, 0))
    with pytest.raises(InputError, match="has sweeps of 1 machine;"):
        sweeps_of(str(tmp_path / "season"))
    assert main(["fleet", "diagnose", str(tmp_path / "season")]) == 2
    assert "expected at least 3" in capsys.readouterr().err


LOG_COLUMNS = ("kind", "name", "first_number", "last_number")


def commit_logs(dataset: Dataset, token: str, name: str, logs: dict[str, tuple[list, str]]) -> None:
    """A day of several logs: name -> seconds and digest."""
    with dataset.workspace() as folder:
        output = folder / "output"
        output.mkdir()
        rows, spans = [], []
        for log, (seconds, _) in logs.items():
            first = len(rows) + 1
            rows += [replace(row, number=first + k) for k, row in enumerate(seconds)]
            spans.append(dict(zip(LOG_COLUMNS, (tables.LOG, log, first, len(rows)), strict=True)))
        columns = {field: [getattr(row, field) for row in rows] for field in rows[0].__dataclass_fields__}
        pq.write_table(pa.table(columns), output / "records.parquet")
        tables.write(tables.LOADS, spans, output / "loads.parquet")
        for table in (tables.SWEEPS, tables.FAULTS, tables.PARAMETERS):
            tables.write(table, [], output / f"{table}.parquet")
        known = {
            "machine_document": json.dumps(machine_file.to_document(MACHINE)),
            "parameters_document": json.dumps(parameter_file.to_document(SHIPPED)),
            "logs": json.dumps([[log, digest] for log, (_, digest) in logs.items()]),
        }
        tables.write(tables.PROVENANCE, [known], output / "provenance.parquet")
        dataset.commit(name, output, {"key": name, "poisoned": []}, token)


def dated(rows: list, later_s: float = 0.0) -> list:
    return [replace(row, time_s=row.time_s + 1.79e9 + later_s) for row in rows]


def test_a_sweep_that_two_logs_hold_is_one_sweep(tmp_path: Path) -> None:
    """A second recorder's log, a converted one and a copy under a second machine."""
    dataset = Dataset(str(tmp_path / "season"))
    token = dataset.begin()
    of_machine = [dated(rows_of(0, 10 * machine)) for machine in range(3)]
    for machine, rows in enumerate(of_machine):
        commit_logs(dataset, token, f"machine=m{machine}/day=0", {"a.log": (rows, f"a{machine}")})
    once = {m.name: m.days for m in sweeps_of(str(tmp_path / "season"))}
    second = dated(rows_of(0, 0), 0.3)[40:]
    commit_logs(dataset, token, "machine=m0/day=0", {"a.log": (of_machine[0], "a0"), "second recorder.log": (second, "b0")})
    commit_logs(dataset, token, "machine=m1/day=1", {"converted.mf4": (dated(rows_of(0, 10)), "b1")})
    commit_logs(dataset, token, "machine=renamed/day=0", {"a.log": (of_machine[2], "a2")})
    assert {m.name: m.days for m in sweeps_of(str(tmp_path / "season"))} == once


def test_what_a_second_log_alone_holds_counts(tmp_path: Path) -> None:
    dataset = Dataset(str(tmp_path / "season"))
    token = dataset.begin()
    for machine in range(3):
        rows = dated(rows_of(0, 10 * machine))
        logs = {"a.log": (rows[:100], f"a{machine}"), "b.log": (rows[80:], f"b{machine}")}
        commit_logs(dataset, token, f"machine=m{machine}/day=0", logs)
    every = sweeps_of(str(tmp_path / "season"))
    assert len(every) == 3
    for machine, found in enumerate(every):
        times = [row.time_s for row in found.days[0]]
        assert times == [row.time_s for row in dated(rows_of(0, 10 * machine)) if row.usable_for_calibration]
