"""A virtual test facility: known flows over the machine, plate angles and speeds set, mean forces read off."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from studies.facility.mean_force import pattern_impulses_n_s, shown_force_n, true_angle_rad, true_speed_rad_s
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant.combine import pulse_table
from yieldmon.plant.pulse_table import PulseTable
from yieldmon.plant.scenario import Scenario

Array = NDArray[np.float64]


def measure(
    scenario: Scenario,
    machine: Machine,
    mass_flows_kg_s: Sequence[float],
    plate_angles_deg: Sequence[float],
    speeds_rpm: Sequence[float] | None = None,
    *,
    averaging_s: float = 20.0,
    trials: int = 1,
    seed: int = 0,
    table: PulseTable | None = None,
) -> dict[str, Array]:
    """Every combination of flow, angle and speed, `trials` times: columns of a measurement table.

    Columns: plate_angle_deg, mass_flow_kg_s, elevator_speed_rpm, trial, force_n (mean over averaging_s, zeroed empty at home)
    and sigma (its standard deviation, N, from paddle scatter and electrical noise). speeds_rpm: default the scenario's. Crop,
    effects, scatter and sensor are the scenario's; its flow, faults and drifts play no part. Raises ValueError for a flow that
    does not fit the paddles or an angle or speed outside 36-94 deg, 240-620 rpm.
    """
    rng = np.random.default_rng(seed)
    table = table or pulse_table(scenario, machine)
    speeds = speeds_rpm if speeds_rpm is not None else [scenario.elevator.speed_rpm]
    grid = np.meshgrid(speeds, plate_angles_deg, mass_flows_kg_s, np.arange(1, trials + 1), indexing="ij")
    rpm, angle, flow, trial = (axis.ravel().astype(float) for axis in grid)
    moisture = scenario.crop.moisture_pct
    force = shown_force_n(table, scenario.effects, flow, np.deg2rad(angle), rpm * RPM, scenario.sensor.response_s, moisture)
    sigma = window_sigma_n(
        table,
        scenario,
        flow,
        true_angle_rad(scenario.effects, np.deg2rad(angle)),
        true_speed_rad_s(scenario.effects, rpm * RPM),
        averaging_s,
        moisture,
    )
    return {
        "plate_angle_deg": angle,
        "mass_flow_kg_s": flow,
        "elevator_speed_rpm": rpm,
        "trial": trial,
        "force_n": force + sigma * rng.standard_normal(len(force)),
        "sigma": sigma,
    }


def window_sigma_n(
    table: PulseTable,
    scenario: Scenario,
    mass_flow_kg_s: Array,
    angle_rad: Array,
    speed_rad_s: Array,
    averaging_s: float,
    coordinate: Array | float = 0.0,
) -> Array:
    """Standard deviation of a mean force over averaging_s, N: scatter of the paddles in it and electrical noise.

    True angle and speed. Vibration averages out over whole patterns and is left out.
    """
    machine = table.machine
    impulses = pattern_impulses_n_s(table, mass_flow_kg_s, angle_rad, speed_rad_s, coordinate)
    patterns = averaging_s * speed_rad_s * machine.sprocket_pitch_radius_m / machine.pattern_length_m
    scatter = scenario.paddle_scatter_pct / 100.0 * np.sqrt((impulses**2).sum(axis=0) * patterns) / averaging_s
    electrical = scenario.sensor.noise_mv * machine.sensor.gain_n_per_mv / np.sqrt(averaging_s * 1000.0)
    return np.asarray(np.hypot(scatter, electrical))


def write_csv(path: Path | str, columns: dict[str, Array]) -> None:
    """Write a measurement table. Raises OSError."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([f"{value:.6g}" for value in row])
