"""Published bench measurements through log and engine: the paddles' masses come out as well as by its own open loop."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.facility.bench_log import (
    DATA,
    EMPTY_S,
    LOG,
    START_S,
    TRIAL_S,
    calibrated,
    configuration,
    errors_on_means_pct,
    measured,
    published,
)
from tests.in_process import program
from tests.whole_logs import load_frames
from yieldmon.bus.bulk import decode_block
from yieldmon.bus.codec import Codec
from yieldmon.cli.main import main
from yieldmon.frames import IMPACT_SENSOR_SAMPLES

GAIN_N_PER_MV = 0.4448


def test_pulses_sum_to_the_published_responses():
    columns = decode_block(Codec(), load_frames(LOG)).messages[IMPACT_SENSOR_SAMPLES]
    samples = np.column_stack([columns.signals[f"Sample{k}"].values for k in range(4)]).ravel()
    zero_mv = samples[: int(1000 * (EMPTY_S - 0.5))].mean()
    assert zero_mv == pytest.approx(500.0, abs=0.05)
    for trial in published():
        first = EMPTY_S + TRIAL_S * trial.number
        passing = samples[int(1000 * first) : int(1000 * (first + TRIAL_S))] - zero_mv
        # Single pulses stand apart: the lowest sample lies between two of them.
        starts = [k for k in range(100, 1700) if passing[k] == passing[k - 60 : k + 60].max()]
        pulses = [passing[k - 28 : k + 29].sum() * 0.001 * GAIN_N_PER_MV / 0.01 for k in starts]
        assert np.median(pulses) == pytest.approx(trial.response, abs=2.5), trial


def test_masses_as_published(tmp_path):
    out = tmp_path / "bench.csv"
    assert main(["process", str(LOG), "--config", str(configuration(tmp_path, calibrated(tmp_path))), "--out", str(out)]) == 0
    with out.open(encoding="utf-8", newline="") as stream:
        rows = [
            {"time_s": float(row["time_s"]) - START_S, **{key: float(row[key]) for key in ("mass_kg", "duration_s")}}
            for row in csv.DictReader(stream)
        ]
    trials = measured(rows)
    assert len(trials) == 60
    assert all(np.isfinite(trial.measured_kg) for trial in trials)
    error_pct = np.abs(errors_on_means_pct(trials))
    theirs = yaml.safe_load((DATA / "published_tables.yaml").read_text(encoding="utf-8"))["bench_open_loop_70deg"]
    print(f"mean error on means {error_pct.mean():.2f} %, largest {error_pct.max():.2f} %")
    assert error_pct.mean() <= theirs["mean_error_on_means_pct"]
    assert error_pct.max() <= theirs["max_error_on_means_pct"]
    rms_kg = float(np.sqrt(np.mean([(trial.measured_kg - trial.load_kg) ** 2 for trial in trials])))
    assert rms_kg <= theirs["rms_kg"]


def test_the_log_is_what_its_tool_makes(tmp_path):
    again = tmp_path / "again.log.gz"
    assert program("studies.published.bench_log", "--out", again).returncode == 0
    assert load_frames(again).payload.tolist() == load_frames(LOG).payload.tolist()


def test_an_angle_without_trials(tmp_path: Path):
    done = program("studies.published.bench_log", "--plate-angle", 41, "--out", tmp_path / "x.log.gz")
    assert done.returncode == 2
    assert done.stderr.startswith("python -m studies.published.bench_log: no trials at 41 deg in ")
