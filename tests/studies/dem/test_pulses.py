"""A campaign's histories as pulses of the virtual combine."""

from __future__ import annotations

import csv
import gzip
from math import pi, radians
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from studies.dem.pulses import CampaignPulses
from yieldmon.errors import InputError
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant import scenario as scenarios
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.pulse_table import QUANTILES, PulseTable
from yieldmon.resources import shipped

FIELDS = [
    "plate_angle_deg",
    "paddle_mass_kg",
    "elevator_speed_rpm",
    "friction",
    "trial",
    "time_s",
    "force_normal_n",
    "force_total_n",
]


def gain(mass: float, angle_deg: float, speed_rpm: float) -> float:
    return 7.0 * mass * np.sin(radians(angle_deg)) * speed_rpm / 400.0


@pytest.fixture
def forces(tmp_path: Path) -> Path:
    """Rectangular pulses of 20 ms that begin 50 ms after the paddle points up, two seeds 10 % apart about the truth."""
    path = tmp_path / "forces.csv.gz"
    with gzip.open(path, "wt", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, FIELDS)
        writer.writeheader()
        for speed in (400.0, 500.0):
            up = 0.6 * pi / (speed * RPM)
            for mass in (0.2, 0.9, 1.8):
                for angle in (40.0, 70.0, 90.0):
                    for trial, factor in ((1, 0.9), (2, 1.1)):
                        for k in range(20):
                            force = factor * gain(mass, angle, speed) / 0.020
                            writer.writerow(
                                dict(
                                    zip(
                                        FIELDS,
                                        [angle, mass, speed, 0.3, trial, up + 0.050 + k * 1e-3, force, 1.2 * force],
                                        strict=True,
                                    )
                                )
                            )
    return path


@pytest.mark.parametrize(("mass", "angle_deg", "speed_rpm"), [(0.2, 40.0, 400.0), (0.9, 70.0, 500.0), (1.8, 90.0, 400.0)])
def test_cells_come_back(forces: Path, mass: float, angle_deg: float, speed_rpm: float) -> None:
    pulses = CampaignPulses.load(forces, 0.3, Machine(), "normal")
    arguments = (mass, radians(angle_deg), speed_rpm * RPM)
    assert float(pulses.impulse_n_s(*arguments)) == pytest.approx(gain(mass, angle_deg, speed_rpm), rel=1e-6)
    times = pulses.arrival_times_s(*arguments)
    assert times.shape == (len(QUANTILES),)
    np.testing.assert_allclose(times, 0.050 + 0.020 * QUANTILES, atol=1e-5)


def test_light_loads_go_as_the_load_and_total_is_more_than_normal(forces: Path) -> None:
    normal, total = (CampaignPulses.load(forces, 0.3, Machine(), force) for force in ("normal", "total"))
    arguments = (np.array([0.0, 0.05, 0.1]), radians(70.0), 400.0 * RPM)
    np.testing.assert_allclose(normal.impulse_n_s(*arguments), [0.0, gain(0.05, 70, 400), gain(0.1, 70, 400)], rtol=1e-6)
    np.testing.assert_allclose(total.impulse_n_s(*arguments), 1.2 * normal.impulse_n_s(*arguments), rtol=1e-9)


def test_kernels_are_kept_apart(forces: Path, tmp_path: Path) -> None:
    """A table of two kernels: each is read by itself, and rows that name none are of spheres."""
    with gzip.open(forces, "rt", encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    path = tmp_path / "both.csv"
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, [*FIELDS, "kernel"])
        writer.writeheader()
        for kernel, factor in (("sphere", 1.0), ("clump", 0.8)):
            writer.writerows({**row, "kernel": kernel, "force_total_n": factor * float(row["force_total_n"])} for row in rows)
    arguments = (0.9, radians(70.0), 400.0 * RPM)
    alone = float(CampaignPulses.load(forces, 0.3, Machine()).impulse_n_s(*arguments))
    for kernel, factor in (("sphere", 1.0), ("clump", 0.8)):
        pulses = CampaignPulses.load(path, 0.3, Machine(), kernel=kernel)
        assert float(pulses.impulse_n_s(*arguments)) == pytest.approx(factor * alone, rel=1e-9)


def test_what_the_campaign_does_not_hold_is_refused(forces: Path) -> None:
    with pytest.raises(InputError, match="no row at"):
        CampaignPulses.load(forces, 0.5, Machine())
    with pytest.raises(InputError, match=r"no row at 0\.3 of kernel clump"):
        CampaignPulses.load(forces, 0.3, Machine(), kernel="clump")
    with pytest.raises(ValueError, match="above the campaign"):
        CampaignPulses.load(forces, 0.3, Machine()).impulse_n_s(2.0, 1.2, 41.9)


def test_the_virtual_combine_runs_on_them(forces: Path) -> None:
    scenario = scenarios.load(shipped("config/scenarios/steady.yaml")).model_copy(update={"duration_s": 12.0})
    pulses = cast(PulseTable, CampaignPulses.load(forces, 0.3, Machine()))
    combine = VirtualCombine(scenario, Machine(), seed=4, table=pulses)
    names = {frame.message for frame in combine.frames_until(12.0)}
    assert {"ImpactSensorSamples", "ElevatorSpeed", "PlateActuatorFeedback"} <= names
    truth = combine.truth.columns
    flowing = truth["mass_flow_kg_s"] > 1.0
    assert flowing.any()
    expected = 1.2 * 7.0 * np.sin(radians(70.0)) * truth["mass_flow_kg_s"]
    np.testing.assert_allclose(truth["force_n"][flowing][2:], expected[flowing][2:], rtol=0.2)
