"""What a second brought, as batches for the store."""

from __future__ import annotations

from dataclasses import replace

import pytest

from yieldmon.engine.records import CalibrationOutcome
from yieldmon.engine.settings import EngineSettings
from yieldmon.files import parameter_file
from yieldmon.physics.machine import Machine
from yieldmon.service.assembly import build_estimator, build_monitor
from yieldmon.service.journal import Journal, Memory

SHIPPED = parameter_file.load()


@pytest.mark.parametrize(
    ("given", "weighed", "origin"), [("sweep", False, "sweep"), ("sweep", True, "ticket"), ("file", True, "file")]
)
def test_new_parameters_say_where_they_came_from(given: str, weighed: bool, origin: str) -> None:
    """A lesson of the engine's own is a sweep's or a weighed mass's; a file is a file, whatever taught before it."""
    monitor, journal = build_monitor(EngineSettings(), Machine(), SHIPPED), Journal(Memory(), SHIPPED)
    assert [version.origin for version in journal.batch(monitor, 0.0, {}, "file").parameter_versions] == ["file"]
    assert journal.batch(monitor, 1.0, {}, "sweep").parameter_versions == ()
    learnt = build_estimator(Machine(), replace(SHIPPED, version=SHIPPED.version + 1))
    monitor.set_estimator(learnt, 0.0)
    monitor._outcome = CalibrationOutcome(learnt, "", weighed=weighed)
    (version,) = journal.batch(monitor, 2.0, {}, given).parameter_versions
    assert (version.version, version.origin) == (SHIPPED.version + 1, origin)
