"""What a second brought, as batches for the store."""

from __future__ import annotations

from dataclasses import replace

import pytest

from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.self_calibration.parameter_updater import ParametersChanged
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.state import EngineState
from yieldmon.files import parameter_file
from yieldmon.physics.machine import Machine
from yieldmon.service.assembly import build_monitor
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.memory import Memory

SHIPPED = parameter_file.load()


@pytest.mark.parametrize("origin", ["sweep", "ticket"])
def test_new_parameters_say_where_they_came_from(origin: str) -> None:
    monitor, journal = build_monitor(EngineSettings(), Machine(), SHIPPED), Journal(Memory(), SHIPPED, now_s=0.0)
    journal.new_monitor(SHIPPED, "file")
    assert [version.origin for version in journal.batch(monitor, 0.0, {}).parameter_versions] == ["file"]
    assert journal.batch(monitor, 1.0, {}).parameter_versions == ()
    learnt = replace(SHIPPED, version=SHIPPED.version + 1)
    journal.happened([ParametersChanged(learnt, origin, "")])
    (version,) = journal.batch(monitor, 2.0, {}).parameter_versions
    assert (version.version, version.origin) == (SHIPPED.version + 1, origin)
    journal.new_monitor(learnt, "file")
    assert journal.batch(monitor, 3.0, {}).parameter_versions == ()


def test_faults_that_a_new_monitor_does_not_show_are_gone() -> None:
    """The store showed two faults when the power went; one is still there."""
    memory = Memory(faults=("SensorMissing", "CalibrationOld"))
    monitor, journal = build_monitor(EngineSettings(), Machine(), SHIPPED), Journal(memory, SHIPPED, now_s=0.0)
    journal.new_monitor(SHIPPED, "file")
    monitor.tick(1000.0)
    journal.take([result for second in range(1, 3) for result in monitor.tick(1000.0 + second)])
    faults = [(fault.code, fault.active) for fault in journal.batch(monitor, 1.0, {}).faults]
    assert ("CalibrationOld", False) in faults
    assert ("SpeedMissing", True) in faults
    assert not [fault for fault in faults if fault[0] == "SensorMissing"]


def test_a_load_is_written_when_it_begins_when_it_grows_and_when_it_ends() -> None:
    monitor, journal = build_monitor(EngineSettings(), Machine(), SHIPPED), Journal(Memory(), SHIPPED, now_s=0.0)
    assert [load.number for load in journal.batch(monitor, 0.0, {}).loads] == [1]
    assert journal.batch(monitor, 1.0, {}).loads == ()
    monitor.tick(1000.0)
    journal.happened(monitor.start_load())
    loads = journal.batch(monitor, 2.0, {}).loads
    assert [(load.number, load.ended_s) for load in loads] == [(1, 1000.0), (2, None)]
    journal.happened(monitor.stop_load())
    assert [(load.number, load.ended_s) for load in journal.batch(monitor, 3.0, {}).loads] == [(2, 1000.0)]


def test_what_happens_before_the_first_batch_has_the_time_of_the_start() -> None:
    monitor, journal = build_monitor(EngineSettings(), Machine(), SHIPPED), Journal(Memory(saved_s=5e8), SHIPPED, now_s=1.7e9)
    journal.new_monitor(SHIPPED, "file")
    assert [action.time_s for action in journal.batch(monitor, 1.7e9 + 5.0, {}).actions] == [1.7e9]


SAVED_S = 1.7e9


@pytest.mark.parametrize(
    ("totals", "saved_s", "now_s", "expected"),
    [
        (Totals(load_number=7, load_kg=50.0), SAVED_S, SAVED_S + 25.0, (7, 25.0)),
        (Totals(load_number=7, load_kg=50.0), SAVED_S, SAVED_S - 40.0, None),
        (Totals(load_number=7, load_kg=50.0), 100.0, SAVED_S, None),
        (Totals(load_number=7, load_kg=50.0), SAVED_S, 100.0, None),
        (Totals(load_number=7, load_kg=50.0), 100.0, 125.0, None),
        (Totals(load_number=7), SAVED_S, SAVED_S + 25.0, None),
        (Totals(load_number=7, load_kg=50.0, load_open=False), SAVED_S, SAVED_S + 25.0, None),
        (None, SAVED_S, SAVED_S + 25.0, None),
    ],
    ids=["open", "set back", "not set before", "not set now", "never set", "empty", "closed", "new store"],
)
def test_a_load_that_goes_on_lacks_what_came_between(
    totals: Totals | None, saved_s: float, now_s: float, expected: tuple[int, float] | None
) -> None:
    """After a stop with a clock that was not set it lacked 54 years."""
    engine = None if totals is None else EngineState(totals=totals)
    journal = Journal(Memory(engine=engine, saved_s=saved_s), parameter_file.load(), now_s=now_s)
    assert journal.unrecorded == expected
