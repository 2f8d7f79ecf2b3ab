"""Published bench measurements over a real bus at their own pace: replay, daemon and candump side by side."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from tests.facility.bench_log import EMPTY_S, LOG, TRIAL_S, Trial, configuration, errors_on_means_pct, measured, published
from tests.vcan.nodes import CODEC, PATIENCE_S, Command, candump, daemon, eventually
from yieldmon import frames
from yieldmon.bus.log_files.logs import read_log
from yieldmon.cli.main import main
from yieldmon.service.storage.rows import SecondRow

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

#: The thesis's open loop on means at this plate angle, mean over the loads.
PUBLISHED_MEAN_ERROR_PCT = 2.53


def as_trials(rows: list[dict[str, float]], first_s: float) -> list[Trial]:
    return measured([row | {"time_s": row["time_s"] - first_s} for row in rows])


def test_masses_over_a_bus_at_its_own_pace(vcan0: str, tmp_path: Path, record_property) -> None:
    path = configuration(tmp_path)
    recording = tmp_path / "seen.log"
    with daemon(vcan0, tmp_path, path.read_text(encoding="utf-8")) as node, candump(vcan0, recording):
        words = ["replay", str(LOG), "-i", "socketcan", "--map", f"can0={vcan0}"]
        Command(words, tmp_path / "replay.txt", {}).finished(PATIENCE_S + 150.0)
        last = node.windows
        eventually(lambda: node.windows > last, "the last window")
    with node.store() as store:
        live: list[SecondRow] = store.seconds()
    assert sum(row.lost_frames + row.surplus_frames + row.repeated_frames for row in live) == 0

    seen = list(read_log(recording))
    known = {name: layout.frame_id for name, layout in CODEC.layouts.items()}
    assert {known[name] for name in (frames.MASS_FLOW, frames.ACCUMULATED_MASS)} <= {m.arbitration_id for m in seen}
    sensor = [m.timestamp for m in seen if m.arbitration_id == known[frames.IMPACT_SENSOR_SAMPLES]]
    first_s = sensor[0]
    span_s = EMPTY_S + TRIAL_S * len(published())
    assert sensor[-1] - first_s == pytest.approx(span_s, abs=0.1)
    trials = as_trials([{"time_s": r.time_s, "mass_kg": r.mass_kg, "duration_s": r.duration_s} for r in live], first_s)
    assert [trial.number for trial in trials] == [trial.number for trial in published()]
    errors_pct = errors_on_means_pct(trials)
    record_property("mean_error_pct", round(float(np.mean(np.abs(errors_pct))), 3))
    assert np.mean(np.abs(errors_pct)) <= PUBLISHED_MEAN_ERROR_PCT

    out = tmp_path / "seen.csv"
    assert main(["process", str(recording), "--config", str(path), "--out", str(out)]) == 0
    with out.open(encoding="utf-8", newline="") as stream:
        processed = [{k: float(row[k]) for k in ("time_s", "mass_kg", "duration_s")} for row in csv.DictReader(stream)]
    again = as_trials(processed, first_s)
    # candump prints microseconds, and the daemon takes nanoseconds.
    assert [trial.measured_kg for trial in trials] == pytest.approx([trial.measured_kg for trial in again], rel=1e-3)
