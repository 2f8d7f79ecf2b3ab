"""A computer without a clock of its own: its date comes from the network after the daemon has begun."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import yaml

from tests.service.bench import START_S, traffic
from yieldmon import utc
from yieldmon.files import parameter_file
from yieldmon.service.config import configuration
from yieldmon.service.history.memory import Memory
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
