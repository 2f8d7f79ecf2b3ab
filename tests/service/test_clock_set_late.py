"""A computer without a clock of its own: its date comes from the network after the daemon has begun."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from tests.service.bench import START_S, traffic
from yieldmon import utc
from yieldmon.files import parameter_file
from yieldmon.resources import shipped
from yieldmon.service.assembly import monitor_of
from yieldmon.service.config import configuration
from yieldmon.service.history.memory import Memory
from yieldmon.service.history.resumption import resume
from yieldmon.service.measuring import Measuring

CALIBRATED_S, DAY_S = 1_700_000_000.0, 86_400.0


@pytest.mark.parametrize(("set_to_s", "age_s"), [(100.0, None), (CALIBRATED_S + 60.0 * DAY_S, 60.0 * DAY_S)])
def test_the_age_of_the_calibration_is_known_once_the_clock_is_set(
    set_to_s: float, age_s: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stayed unknown until the next start, and CalibrationOld away."""
    document = parameter_file.to_document(parameter_file.load())
    document["provenance"] = {"date": utc.text(utc.moment(CALIBRATED_S))}
    (tmp_path / "p.yaml").write_text(yaml.safe_dump(document))
    (tmp_path / "c.yaml").write_text("parameter_file: p.yaml")
    monkeypatch.setattr(time, "time", lambda: 100.0)
    measuring = Measuring(configuration.load(tmp_path / "c.yaml", {}), Memory())
    assert measuring.monitor.snapshot().calibration_age_s is None
    monkeypatch.setattr(time, "time", lambda: set_to_s)
    for frame in traffic(START_S, 3.0, 0.0):
        measuring.take(measuring.monitor.completed(measuring.monitor.feed(frame)))
    found = measuring.monitor.snapshot().calibration_age_s
    assert found == (None if age_s is None else pytest.approx(age_s, abs=3.0))


@pytest.mark.parametrize(
    ("saved_s", "now_s", "age_s"),
    [
        (CALIBRATED_S, CALIBRATED_S + DAY_S, 2.0 * DAY_S),
        (100.0, CALIBRATED_S, DAY_S),
        (CALIBRATED_S, 100.0, DAY_S),
    ],
    ids=["set both times", "not set before", "not set now"],
)
def test_a_stop_is_as_long_as_the_clock_can_tell(saved_s: float, now_s: float, age_s: float) -> None:
    """After a day on which no network set the clock, a calibration was 54 years old."""
    loaded = configuration.load(shipped("config/yieldmon.yaml"), {})
    monitor = monitor_of(loaded, loaded.parameters)
    memory = Memory(engine=replace(monitor.snapshot(), calibration_age_s=DAY_S), saved_s=saved_s)
    resume(monitor, memory, "store", loaded.parameters, now_s)
    assert monitor.snapshot().calibration_age_s == pytest.approx(age_s)
