"""What machines share is the model's, what one has is its own; sweeps of a dataset are those of a store."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.plant_sweeps import MACHINE, NONE, STRONG, shown_force, sweep_windows
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import machine_file, parameter_file
from yieldmon.fleet import tables
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.diagnosis import (
    Explanation,
    MachineSweeps,
    MachineVerdict,
    Named,
    diagnose,
    shared_effects,
    sweeps_of,
    verdict_of,
)
from yieldmon.service import sweep_table
from yieldmon.service.batch import Batch, ParameterVersion
from yieldmon.service.rows import second_row
from yieldmon.service.store import Store

SHIPPED = parameter_file.load()
FRICTION = Named("plate_friction", ("lever_arm",), 0.9, {"plate_friction.friction": 0.2})
LEVER = Named("lever_arm", ("plate_friction",), 0.6, {"lever_arm.share": 0.1})
AIR = Named("air_drag", (), 0.9, {"air_drag.factor": 1.0})


def verdict(name: str, *named: Named) -> MachineVerdict:
    return MachineVerdict(name, "effect" if named else "none", named)


@pytest.mark.parametrize(
    ("machines", "shared"),
    [
        ([(FRICTION,)] * 4, ["plate_friction"]),
        ([(FRICTION,), (FRICTION,), (LEVER,), ()], ["plate_friction"]),
        ([(FRICTION, AIR)] * 3, ["plate_friction", "air_drag"]),
        ([(FRICTION,), (FRICTION, AIR), (FRICTION,)], ["plate_friction"]),
        ([(AIR,), (), (), ()], []),
        ([(AIR,), (AIR,), (), ()], []),
        ([(AIR,), (AIR,), (AIR,), (), (), ()], []),
        ([()] * 4, []),
    ],
)
def test_shared_is_what_most_machines_show(machines: list[tuple[Named, ...]], shared: list[str]) -> None:
    found = shared_effects([verdict(f"m{i}", *named) for i, named in enumerate(machines)])
    assert sorted(item.effect for item in found) == sorted(shared)


def test_values_of_a_shared_effect_are_the_machines_mean() -> None:
    named = [Named("air_drag", (), 1.0, {"air_drag.factor": value}) for value in (0.8, 1.0, 1.2)]
    [found] = shared_effects([verdict(f"m{i}", item) for i, item in enumerate(named)])
    assert found.values == {"air_drag.factor": pytest.approx(1.0)}


def tied(friction_behind: float, lever_behind: float, friction: float = 0.2, law: str = "plate_friction") -> Named:
    """A machine whose sweeps cannot tell friction from the lever arm, and how far each is behind."""
    explanations = {
        "plate_friction": Explanation(law, {f"{law}.friction": friction}, friction_behind),
        "lever_arm": Explanation("lever_arm", {"lever_arm.slope": 0.3}, lever_behind),
    }
    first, other = ("plate_friction", "lever_arm") if friction_behind <= lever_behind else ("lever_arm", "plate_friction")
    return Named(first, (other,), 0.6, explanations[first].values, explanations)


@pytest.mark.parametrize(
    ("machines", "shared"),
    [
        # Named first more often, but where it is not, it is further behind.
        ([(0.0, 1.0), (0.0, 1.0), (5.0, 0.0)], "lever_arm"),
        ([(0.0, 3.0), (0.0, 3.0), (5.0, 0.0)], "plate_friction"),
    ],
)
def test_all_machines_evidence_together_tells_what_one_cannot(machines: list[tuple[float, float]], shared: str) -> None:
    [found] = shared_effects([verdict(f"m{i}", tied(*behind)) for i, behind in enumerate(machines)])
    assert found.effect == shared


def test_values_are_the_median_by_the_law_that_most_machines_fitted() -> None:
    named = [tied(0.0, 9.0, 0.1), tied(0.0, 9.0, 0.2), tied(4.0, 0.0, 0.6), tied(0.0, 9.0, 7.0, "friction_by_another_law")]
    [found] = shared_effects([verdict(f"m{i}", item) for i, item in enumerate(named)])
    assert found.values == {"plate_friction.friction": 0.2}


@pytest.mark.parametrize(("naming", "shared"), [(2, []), (3, ["plate_friction"])])
def test_effects_that_are_no_name_by_themselves_count_where_enough_machines_name_them(naming: int, shared: list[str]) -> None:
    unsure = [MachineVerdict(f"u{i}", "unknown", (), (tied(0.0, 1.0),)) for i in range(4)]
    found = shared_effects([*(verdict(f"m{i}", FRICTION) for i in range(naming)), *unsure])
    assert [item.effect for item in found] == shared


def test_what_most_machines_still_show_is_the_models_too() -> None:
    machines = [MachineSweeps(f"m{i}", MACHINE, SHIPPED, ()) for i in range(4)]

    def ask(pairs: Sequence[tuple[MachineSweeps, ParameterSet]]) -> Iterable[MachineVerdict]:
        left = {"plate_friction": FRICTION, "air_drag": AIR}
        return [verdict(m.name, *[item for name, item in left.items() if name not in p.effects][:1]) for m, p in pairs]

    found = diagnose(machines, ask)
    assert [item.effect for item in found.model] == ["plate_friction", "air_drag"]
    assert found.of_machines == ()


@pytest.mark.slow
def test_a_named_effect_comes_with_its_laws_values_and_with_what_was_fitted_in_its_place() -> None:
    force = shown_force(MACHINE, STRONG)
    windows = [
        window
        for sweep in range(4)
        for window in sweep_windows(
            MACHINE, force, flow_kg_s=7.0 + 3.0 * sweep, seed=sweep, start_s=1800.0 * sweep, sweep_id=sweep + 1
        )
    ]
    seconds = tuple(second_row(number, window) for number, window in enumerate(windows, 1))
    found = verdict_of(MachineSweeps("m", MACHINE, SHIPPED, (seconds,)), SHIPPED)
    for item in (*found.named, *found.partial):
        own = item.explanations[item.effect]
        assert own.behind == 0.0
        assert own.values == item.values
        assert {name.partition(".")[0] for name in item.values} == {own.law}
        assert set(item.equivalent) <= set(item.explanations)
    assert found.named or found.partial


def test_what_the_shared_effect_leaves_is_the_machines_own() -> None:
    machines = [MachineSweeps(f"m{i}", MACHINE, SHIPPED, ()) for i in range(4)]
    asked = []

    def ask(pairs: Sequence[tuple[MachineSweeps, ParameterSet]]) -> Iterable[MachineVerdict]:
        asked.append([parameters.values.get("plate_friction.friction") for _, parameters in pairs])
        own = {"m2": (AIR,)}
        return [verdict(m.name, *(() if p.effects != SHIPPED.effects else (FRICTION,)), *own.get(m.name, ())) for m, p in pairs]

    found = diagnose(machines, ask)
    assert [item.effect for item in found.model] == ["plate_friction"]
    assert [(item.name, [n.effect for n in item.named]) for item in found.of_machines] == [("m2", ["air_drag"])]
    assert asked == [[None] * 4, [pytest.approx(0.2)] * 4]


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
    with pytest.raises(InputError, match="has sweeps of 1 machines"):
        sweeps_of(str(tmp_path / "season"))
    assert main(["fleet", "diagnose", str(tmp_path / "season")]) == 2
    assert "expected at least 3" in capsys.readouterr().err
