"""Sweeps that a pass's end or a hole in the crop cuts off say nothing of the model: what is stated of the total stays."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from yieldmon import api
from yieldmon.engine.records import WindowRecord

SLOW = pytest.mark.slow
EMPTY = {"kind": "steady", "duration_s": 12, "flow_kg_s": 0}
SHORT_PASSES = [EMPTY, {"kind": "stop-and-go", "duration_s": 600, "flow_kg_s": 12, "pass_s": 14, "headland_s": 3}]
HOLES = [EMPTY, *({"kind": "steady", "duration_s": s, "flow_kg_s": f} for _ in range(20) for s, f in ((17.3, 12), (4.0, 2.0)))]


def harvested(tmp_path: Any, pieces: list[dict[str, Any]], seed: int) -> list[WindowRecord]:
    """The seconds of a combine that follows the model, with a sweep as often as there can be one."""
    scenario, configuration = tmp_path / "scenario.yaml", tmp_path / "c.yaml"
    frames = {"grain_condition": True, "position": False, "harvest_state": False}
    scenario.write_text(yaml.safe_dump({"duration_s": 300, "flow": {"variation_pct": 3.0, "pieces": pieces}, "frames": frames}))
    configuration.write_text("sweep: {first_after_s: 60, interval_s: 60, backoff_s: 5}\n")
    loaded = api.load_configuration(configuration)
    monitor = api.build_monitor(loaded.engine, loaded.machine, loaded.parameters, loaded.calibrator)
    combine = api.VirtualCombine(api.load_scenario(scenario), loaded.machine, seed)
    records = []
    for frame in combine.frames_until(300.0):
        for result in monitor.feed(frame):
            for answer in result.frames:
                combine.handle(answer)
            if isinstance(result, api.WindowResult):
                records.append(result.record)
    return records


@pytest.mark.parametrize(
    ("pieces", "seed"),
    [(SHORT_PASSES, 1), pytest.param(SHORT_PASSES, 2, marks=SLOW), (HOLES, 1), pytest.param(HOLES, 2, marks=SLOW)],
)
def test_a_pass_that_ends_in_a_sweep_does_not_widen_what_is_said(tmp_path: Any, pieces: list[dict[str, Any]], seed: int) -> None:
    records = harvested(tmp_path, pieces, seed)
    assert max(record.sweep_id for record in records) >= 3, "sweeps begin"
    stated = [record.total_std_dev_kg / record.total_kg for record in records if record.total_kg > 300.0]
    assert max(stated) < 0.13, "the shipped parameters' own is some 9 %"
