"""Volume flow from the shape of discrete-element pulses: load and plate angle left out, calibrated on all others."""

from __future__ import annotations

import csv
import gzip
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.dem.job import TOP_RAD, Throw
from studies.dem.script import start_angle_rad
from yieldmon.estimation.pulse_shape import PatternWave, PulseModel, PulseSettings, calibrate_arrival, estimate
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel

Array = NDArray[np.float64]
DATA = Path(__file__).resolve().parents[2] / "tests" / "data" / "dem_campaign_forces.csv.gz"
LOADS_KG = (0.2, 0.5, 0.9, 1.3, 1.8)
ANGLES_DEG = (40.0, 55.0, 70.0, 80.0, 90.0)
DENSITY_KG_M3 = 710.0
SHAPE_RATIO = 2.9
HARMONICS = 12
CELL_S = 0.008
MACHINE = replace(Machine(), paddle_spacings_m=(Machine().paddle_spacing_m,))


def histories() -> dict[tuple[float, float, float, float], Array]:
    """Force over time (n, 2) of the first seed by (rpm, friction, load, plate angle); time from the paddle's pointing up."""
    rows: dict[tuple[float, float, float, float], list[tuple[float, float]]] = defaultdict(list)
    lead = TOP_RAD - start_angle_rad(Throw(paddle_mass_kg=1.0))
    with gzip.open(DATA, "rt", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            if row["trial"] == "1":
                rpm = float(row["elevator_speed_rpm"])
                key = (rpm, float(row["friction"]), float(row["paddle_mass_kg"]), float(row["plate_angle_deg"]))
                rows[key].append((float(row["time_s"]) + 5e-4 - lead / (rpm * RPM), float(row["force_total_n"])))
    return {key: np.array(values) for key, values in rows.items()}


def wave(history: Array, rpm: float, angle_deg: float) -> PatternWave:
    """Harmonics of a steady train of one pulse, one to a mean paddle spacing, through a cell of 8 ms."""
    base = 2.0 * np.pi * MACHINE.paddle_speed_m_s(rpm * RPM) / MACHINE.pattern_length_m
    omega = base * np.arange(1, HARMONICS + 1)
    time = history[:, 0] + 2.0 * np.pi / base
    amplitude = (history[:, 1] * 1e-3 * np.exp(-1j * np.outer(omega, time))).sum(axis=1) * base / (2.0 * np.pi)
    return PatternWave(
        amplitude / (1.0 + 1j * omega * CELL_S) ** 2, np.full(HARMONICS, 0.06), 12.0, rpm * RPM, np.deg2rad(angle_deg)
    )


def volume_flow_m3_s(load_kg: float, rpm: float) -> float:
    """Of a train of loads."""
    return load_kg / DENSITY_KG_M3 * MACHINE.paddle_speed_m_s(rpm * RPM) / MACHINE.paddle_spacing_m


def left_out(rpm: float, friction: float, model_error: float, indexed: bool) -> tuple[Array, Array]:
    """Error of ln(volume flow) and its stated standard deviation, (loads, angles), each cell judged by a calibration without its
    load and without its angle."""
    data = histories()
    model = ForwardModel(MACHINE, ("gravity",))
    grain = {
        "friction": friction, "density": DENSITY_KG_M3, "shape_ratio": SHAPE_RATIO, "restitution": 0.3,
        "gravity.acceleration_m_s2": 9.81,
    }  # fmt: skip
    sd = {**PulseSettings().sd, "log_friction": 0.03, "log_shape_ratio": 0.02, "log_cell": 0.02}
    settings = PulseSettings(
        harmonics=HARMONICS, model_error=model_error, cell_response_s=CELL_S, vibration_n=0.0, sd=sd, indexed=indexed
    )
    base = PulseModel(model, grain, settings)
    waves = {(m, a): wave(data[rpm, friction, m, a], rpm, a) for m in LOADS_KG for a in ANGLES_DEG}
    errors, stated = (np.empty((len(LOADS_KG), len(ANGLES_DEG))) for _ in range(2))
    for i, load in enumerate(LOADS_KG):
        for j, angle in enumerate(ANGLES_DEG):
            known = [key for key in waves if key[0] != load and key[1] != angle]
            law = calibrate_arrival(base, [waves[k] for k in known], [volume_flow_m3_s(k[0], rpm) for k in known], terms=5)
            found = estimate(PulseModel(model, grain, replace(settings, arrival=law)), waves[load, angle])
            errors[i, j] = np.log(found.volume_flow_m3_s / volume_flow_m3_s(load, rpm))
            stated[i, j] = found.relative_sd
    return errors, stated


def report(model_error: float, indexed: bool) -> list[dict[str, Any]]:
    """A row for each speed and friction; `inner`: loads and angles between others."""
    rows = []
    for rpm, friction in ((400.0, 0.3), (400.0, 0.15), (500.0, 0.3), (500.0, 0.15)):
        errors, stated = left_out(rpm, friction, model_error, indexed)
        inner = np.abs(errors[1:-1, 1:-1])
        rows.append(
            {
                "rpm": rpm, "friction": friction, "indexed": indexed, "model_error": model_error,
                "inner_mean_pct": round(100.0 * float(inner.mean()), 1),
                "inner_largest_pct": round(100.0 * float(inner.max()), 1),
                "all_mean_pct": round(100.0 * float(np.abs(errors).mean()), 1),
                "all_largest_pct": round(100.0 * float(np.abs(errors).max()), 1),
                "rms_error_over_sd": round(float(np.sqrt(np.mean((errors / stated) ** 2))), 2),
                "errors_pct": np.round(100.0 * errors, 1).tolist(),
            }
        )  # fmt: skip
    return rows
