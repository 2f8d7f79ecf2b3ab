"""What the log of python -m studies.published.bench_log holds, and the masses that a table of seconds tells of it."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from yieldmon.cli.main import main
from yieldmon.physics.machine import RPM, Machine

DATA = Path(__file__).parents[1] / "data"
LOG = DATA / "bench_log.log.gz"
START_S, EMPTY_S, TRIAL_S = 1_000_000_000, 15.5, 2.2
#: A second's result weighs what came from this long before its end on: the second and the ramp before it, one paddle pattern.
SUPPORT_S = 1.17
MACHINE = Machine()
PASSES_PER_S = MACHINE.paddle_speed_m_s(400.0 * RPM) / MACHINE.paddle_spacing_m


@dataclass(frozen=True)
class Trial:
    """A trial's place in the log, its published load and what was measured for it, kg a paddle."""

    number: int
    load_kg: float
    response: float
    measured_kg: float = float("nan")


def published() -> list[Trial]:
    """The trials at 70 deg in the order of the log."""
    with (DATA / "bench_table.csv").open(encoding="utf-8", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["plate_angle_deg"] == "70"]
    rows.sort(key=lambda row: (int(row["trial"]), float(row["paddle_mass_kg"])))
    return [Trial(k, float(row["paddle_mass_kg"]), float(row["response"])) for k, row in enumerate(rows)]


def measured(rows: list[dict[str, float]]) -> list[Trial]:
    """The trials that the seconds cover; rows: time_s since the log's start, mass_kg, duration_s."""
    found = []
    for trial in published():
        begin_s = EMPTY_S + TRIAL_S * trial.number
        inside = [row for row in rows if begin_s + SUPPORT_S <= row["time_s"] <= begin_s + TRIAL_S - 0.01]
        if inside:
            kg = inside[0]["mass_kg"] / inside[0]["duration_s"] / PASSES_PER_S
            found.append(Trial(trial.number, trial.load_kg, trial.response, kg))
    return found


def errors_on_means_pct(trials: list[Trial]) -> np.ndarray:
    """Error of the mean over each load's trials."""
    loads = np.array([trial.load_kg for trial in trials])
    masses = np.array([trial.measured_kg for trial in trials])
    return np.array([100.0 * (masses[loads == load].mean() / load - 1.0) for load in np.unique(loads)])


def calibrated(folder: Path) -> Path:
    """Parameters of the bench's pellets, calibrated at 70 deg as published."""
    parameters = folder / "pellets.yaml"
    words = ["--plate-angle", "70", "--impact", "exchange", "--response-scale", "100", "--fix", "shape_ratio=2"]
    # The pellets on the bench are fitted best outside the physical ranges of grain.
    words += ["--bounds", "friction=0:2", "--bounds", "density=300:3000"]
    assert main(["calibrate", str(DATA / "bench_table.csv"), "--out", str(parameters), *words]) == 0
    return parameters


def configuration(folder: Path, parameters: Path = DATA / "bench_pellets.yaml") -> Path:
    """A configuration with these parameters; default: calibrated() as it was when the log was made."""
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump({"parameter_file": str(parameters)}), encoding="utf-8")
    return path
