"""Published bench measurements over a real bus at their own pace: replay, daemon and candump side by side."""

from __future__ import annotations

import csv
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.facility.bench_log import EMPTY_S, LOG, TRIAL_S, configuration, measured
from tests.vcan.test_peers import listeners
from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.bus.logs import read_log
from yieldmon.cli.main import main
from yieldmon.service import configuration as configurations
from yieldmon.service.daemon import Daemon
from yieldmon.service.store import Store

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

#: Bounds a hang only.
WAIT_S = 120.0
#: One trial of each load: the whole log, at its own pace, would take two and a half minutes.
TRIALS = 6


def test_masses_over_a_bus_at_its_own_pace(vcan0: str, tmp_path: Path) -> None:
    path = configuration(tmp_path)
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    document["bus"] = {"interface": "socketcan", "channel": vcan0}
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    loaded = configurations.load(path, {"STATE_DIRECTORY": str(tmp_path), "RUNTIME_DIRECTORY": str(tmp_path)})
    daemon = Daemon(loaded, environment={})
    thread = threading.Thread(target=daemon.run)
    recording = tmp_path / "seen.log"
    before = listeners(vcan0)
    with recording.open("wb") as output:
        candump = subprocess.Popen(["candump", "-L", vcan0], stdout=output)
        thread.start()
        try:
            assert daemon.started.wait(WAIT_S)
            while listeners(vcan0) == before:
                assert candump.poll() is None, "candump ended before it listened"
            until_s = str(EMPTY_S + TRIALS * TRIAL_S)
            assert main(["replay", str(LOG), "-i", "socketcan", "--map", f"can0={vcan0}", "--to", until_s]) == 0
        finally:
            daemon.request_stop()
            thread.join(WAIT_S)
            candump.terminate()
            candump.wait(WAIT_S)
    assert not thread.is_alive()
    with Store(loaded.store_path) as store:
        live = store.seconds()

    seen = [(message, Codec().decode(message)) for message in read_log(recording)]
    names = {frame.message for _, frame in seen if frame is not None}
    assert {frames.IMPACT_SENSOR_SAMPLES, frames.MASS_FLOW, frames.ACCUMULATED_MASS} <= names
    first_s = next(message.timestamp for message, frame in seen if frame is not None and frame.message in frames.INPUTS)
    out = tmp_path / "seen.csv"
    assert main(["process", str(recording), "--config", str(path), "--out", str(out)]) == 0
    with out.open(encoding="utf-8", newline="") as stream:
        processed = [
            {"time_s": float(row["time_s"]) - first_s, **{k: float(row[k]) for k in ("mass_kg", "duration_s")}}
            for row in csv.DictReader(stream)
        ]
    on_bus = [{"time_s": r.time_s - first_s, "mass_kg": r.mass_kg, "duration_s": r.duration_s} for r in live]
    trials, again = measured(on_bus), measured(processed)
    assert [trial.number for trial in trials] == list(range(TRIALS))
    kg = np.array([trial.measured_kg for trial in trials])
    # candump prints microseconds, and the daemon takes nanoseconds.
    assert kg == pytest.approx([trial.measured_kg for trial in again], rel=1e-3)
    # A single trial scatters by the published 0.022 kg around its load.
    loads = np.array([trial.load_kg for trial in trials])
    assert np.sqrt(np.mean((kg - loads) ** 2)) < 0.03
