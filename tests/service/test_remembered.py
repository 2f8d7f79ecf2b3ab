"""What a start takes from a store, part by part."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest

from tests.service.test_store import second
from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.sampling.zero import ZeroState
from yieldmon.engine.state import EngineState, ZeroUndo
from yieldmon.engine.sweeps.disagreement import SweepPattern
from yieldmon.estimation.self_calibration.misfit import ReducedSweep
from yieldmon.files import calibrated_machine, parameter_file
from yieldmon.physics.machine import Machine
from yieldmon.service.history.load_book import LoadBook
from yieldmon.service.history.memory import Memory, choose_parameters
from yieldmon.service.history.recovery import remembered
from yieldmon.service.storage.batch import Action, Batch, Load, ParameterVersion, Ticket
from yieldmon.service.storage.store import Store


def stored(path: Path, loads: list[int], load_kg: list[float] | None = None, provenance: dict[str, str] | None = None) -> None:
    """A second of 10 kg for each load number. load_kg: of the load until then, 10 kg by default. provenance: of parameters."""
    parameters = parameter_file.to_document(replace(parameter_file.load(), provenance=provenance or {}))
    with Store(path) as store:
        for number, load in enumerate(loads, start=1):
            state = {
                "engine": EngineState(totals=Totals(total_kg=10.0 * number, load_number=load)).as_dict(), "saved_s": 1.0,
                "last_second": number, "parameter_digest": "", "field": "", "crop": "", "faults": [],
            }  # fmt: skip
            versions = (ParameterVersion(1, 1.0, "file", parameters),) if number == 1 else ()
            of_load_kg = 10.0 if load_kg is None else load_kg[number - 1]
            row = second(
                number, mass_kg=10.0, total_kg=10.0 * number, load_number=load, load_kg=of_load_kg, force_n=float(number)
            )
            store.commit([Batch(number, 1.0, state, seconds=(row,), parameter_versions=versions)])


def test_a_state_that_is_older_than_the_last_second_catches_up(tmp_path: Path) -> None:
    """The state is kept twice: where the newer one is lost, the other is a second behind."""
    path = tmp_path / "s.sqlite"
    stored(path, [1] * 6)
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("DELETE FROM state WHERE batch = 6")
    with Store(path) as store:
        found = remembered(store)
    assert (found.engine.totals.total_kg, found.last_second, found.last_batch) == (60.0, 6, 5)
    assert found.engine.totals.total_unknown_moisture_kg == 10.0


@pytest.mark.parametrize(("name", "doubted"), [("sprocket-8", False), ("second", True)])
def test_a_store_of_another_machine_is_named(tmp_path: Path, name: str, doubted: bool) -> None:
    path = tmp_path / "s.sqlite"
    stored(path, [1], provenance=calibrated_machine.facts(Machine()))
    with Store(path) as store:
        found = remembered(store).of_another_machine(Machine(name=name))
    assert ("(the name sprocket-8, here second); totals and loads may be that one's" in found) == doubted == bool(found)


def test_a_state_that_is_not_older_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    stored(path, [1] * 6)
    with Store(path) as store:
        found = remembered(store)
    assert found.engine.totals.total_unknown_moisture_kg == 0.0


@pytest.mark.parametrize("kept", [0, 5], ids=["no state", "a state that is older"])
def test_a_load_that_has_ended_is_not_opened_again(tmp_path: Path, kept: int) -> None:
    path = tmp_path / "s.sqlite"
    stored(path, [1] * 6)
    with Store(path) as store:
        store.commit([Batch(7, 1.0, {"later": True}, loads=(Load(1, "north", "corn", 1.7e9, 1.7e9 + 6.0, 60.0, None),))])
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("DELETE FROM state WHERE batch > ?", (kept,))
    with Store(path) as store:
        totals = remembered(store).engine.totals
    assert (totals.load_number, totals.load_open, totals.load_kg, totals.total_kg) == (1, False, 10.0, 60.0)


@pytest.mark.parametrize("loads", [[1, 1, 2, 2, 2, 5, 6, 6], [3], [1, 2, 3, 4, 5, 6, 7, 8, 9]])
def test_the_seconds_of_a_load_are_all_of_it_and_no_others(tmp_path: Path, loads: list[int]) -> None:
    path = tmp_path / "s.sqlite"
    stored(path, loads)
    with Store(path) as store:
        for load in range(11):
            expected = [number for number, other in enumerate(loads, start=1) if other == load]
            assert [row.number for row in store.seconds_of_load(load)] == expected, load


@pytest.mark.parametrize(
    ("first_load", "expected"),
    [(1, [(2, 1), (3, 1), (4, NO_LOAD), (5, NO_LOAD), (6, 2)]), (2, [(2, 1), (3, 1), (6, 2)])],
    ids=["grain between loads", "totals reset since"],
)
def test_seconds_after_a_loads_end_are_of_no_load(tmp_path: Path, first_load: int, expected: list[tuple[int, int]]) -> None:
    path = tmp_path / "s.sqlite"
    stored(path, [1, 1, 1, 1, 1, 2], [10.0, 20.0, 30.0, 30.0, 30.0, 10.0])
    zero = ZeroState(150.0, 150.0, 41.9, 3.0)
    engine = EngineState(Totals(load_number=2, first_load=first_load), zero=zero, zero_undo=ZeroUndo(zero, suspect=True))
    state = {
        "engine": engine.as_dict(), "saved_s": 1.0, "last_second": 6, "parameter_digest": "", "field": "", "crop": "",
        "faults": [],
    }  # fmt: skip
    with Store(path) as store:
        zeroed = Action(1, 1.0, "zero", "", {"second": 1, "signs": ""})
        ended = Load(1, "", "", 1.7e9, 1.7e9 + 3.0, 30.0, None)
        store.commit([Batch(7, 1.0, state, loads=(ended,), actions=(zeroed,))])
        found = remembered(store).since_zero
    numbers = [second.force_n for second in found]
    assert numbers == [number for number, _ in expected]
    assert [second.load_number for second in found] == [load for _, load in expected]


def test_learnt_parameters_go_on_for_as_long_as_their_file_is_the_same() -> None:
    configured = parameter_file.load()
    learnt = replace(configured, version=7)
    digest = parameter_file.digest(configured)

    def chosen(memory: Memory) -> tuple[int, str]:
        parameters, origin = choose_parameters(memory, configured)
        return parameters.version, origin

    assert chosen(Memory(parameters=learnt, parameter_digest=digest, last_version=7)) == (7, "store")
    assert chosen(Memory(parameters=learnt, parameter_digest="another", last_version=7)) == (8, "file")
    assert chosen(Memory(parameter_digest=digest)) == (configured.version, "file")


def test_parameters_that_no_ticket_has_updated_are_no_calibration_in_a_store_that_does_not_say_so() -> None:
    learnt, configured = parameter_file.load(), parameter_file.on_a_machine(parameter_file.load(), Machine(plate_length_m=0.2))
    memory = Memory(parameters=learnt, parameter_digest=parameter_file.digest(learnt), last_version=1)
    assert choose_parameters(memory, configured)[0].scale_error == configured.scale_error > 0.0
    weighed = replace(memory, tickets=(Ticket(1.7e9, 1, 1, 5000.0, 4000.0),))
    assert choose_parameters(weighed, configured)[0].scale_error == 0.0


SUMMARY = LoadSummary(3, 10.0, 20.0, 1000.0, 850.0, 0.0, complete=True, area_m2=500.0)


@pytest.mark.parametrize(
    ("summary", "dry_kg", "area_m2"),
    [
        (SUMMARY, 850.0, 500.0),
        (replace(SUMMARY, unknown_moisture_kg=400.0), None, 500.0),
        (replace(SUMMARY, unknown_area_kg=900.0), 850.0, None),
        (replace(SUMMARY, area_m2=0.0), 850.0, None),
        (replace(SUMMARY, area_m2=nan), 850.0, None),
    ],
)
def test_a_load_has_the_dry_mass_and_the_area_that_are_known(summary: LoadSummary, dry_kg, area_m2) -> None:
    book = LoadBook(())
    book.measured(summary, "north", "corn")
    (load,) = book
    assert (load.number, load.mass_kg, load.dry_mass_kg, load.area_m2) == (3, 1000.0, dry_kg, area_m2)


@pytest.mark.parametrize(
    ("dry_kg", "area_known", "expected"),
    [
        (17.0, True, MissedMass(21.0, 19.0, 3.0, 4.0)),
        (None, True, MissedMass(21.0, 2.0, 23.0, 4.0)),
        (17.0, False, MissedMass(21.0, 19.0, 3.0, 24.0)),
        (None, False, MissedMass(21.0, 2.0, 23.0, 24.0)),
    ],
)
def test_missed_mass_adds_up(dry_kg, area_known: bool, expected: MissedMass) -> None:
    assert MissedMass(1.0, 2.0, 3.0, 4.0).plus(20.0, dry_kg, area_known=area_known) == expected


@pytest.mark.parametrize("moisture_pct", [nan, 15.5])
def test_a_sweeps_pattern_keeps_what_is_known_of_the_moisture(moisture_pct: float) -> None:
    sweep = ReducedSweep(np.radians([40.0, 60.0]), np.array([1.25, 1.5]), np.array([0.01, 0.02]), 20.0, 40.0, moisture_pct)
    kept = SweepPattern.of(5.0, sweep)
    assert kept.moisture_pct == (None if np.isnan(moisture_pct) else 15.5)
    assert kept.reduced().moisture_pct == pytest.approx(moisture_pct, nan_ok=True)
