"""self-calibrate on grain whose friction has changed since its calibration."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from yieldmon.cli.main import main
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

GRAIN = {"friction": 0.3, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.5}
ANGLES_DEG = np.arange(42.0, 91.0, 6.0)
SEEDS = (1, 2, 3, 4)
CHANGES = (0.85, 1.0, 1.15)
"""Of friction, since the calibration."""


def table(path: Path, flows_kg_s: tuple[float, ...], grain: Mapping[str, float], seed: int) -> str:
    """Three readings at each angle and flow, with noise of 1 %."""
    noise, lines = np.random.default_rng(seed), ["plate_angle_deg,mass_flow_kg_s,force_n"]
    for flow in flows_kg_s:
        force = ForwardModel(Machine()).force(Conditions(np.radians(ANGLES_DEG), 400.0 * RPM, mass_flow_kg_s=flow), grain)
        for angle, newtons in zip(ANGLES_DEG, force, strict=True):
            lines += [f"{angle},{flow},{newtons * (1.0 + scatter)}" for scatter in noise.normal(0.0, 0.01, 3)]
    path.write_text("\n".join(lines) + "\n")
    return str(path)


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, str]]:
    """Parameters and sweeps: of each seed a calibration, of each change three sweeps."""
    folder, out = tmp_path_factory.mktemp("changed"), []
    for seed in SEEDS:
        known = str(folder / f"{seed}.yaml")
        assert main(["calibrate", table(folder / f"{seed}.csv", (3.0, 8.0, 14.0), GRAIN, seed), "--out", known]) == 0
        for change in CHANGES:
            grain = GRAIN | {"friction": change * GRAIN["friction"]}
            out.append((known, table(folder / f"{seed}-{change}.csv", (6.0, 11.0, 17.0), grain, 100 + seed)))
    return out


def deviations(capsys: pytest.CaptureFixture[str], cases: list[tuple[str, str]], *words: str) -> np.ndarray:
    """Errors of the flows in stated standard deviations, (cases, sweeps)."""
    out = []
    for known, sweeps in cases:
        capsys.readouterr()
        assert main(["self-calibrate", sweeps, "--params", known, "--json", *words]) == 0
        groups = json.loads(capsys.readouterr().out)["groups"]
        out.append([(g["mass_flow_kg_s"] - g["true_mass_flow_kg_s"]) / g["std_dev_kg_s"] for g in groups])
    return np.array(out)


def test_flows_are_covered_where_the_change_is_allowed_for(
    capsys: pytest.CaptureFixture[str], cases: list[tuple[str, str]]
) -> None:
    assert np.sqrt(np.mean(deviations(capsys, cases) ** 2)) > 3.0
    assert np.sqrt(np.mean(deviations(capsys, cases, "--drift", "friction=0.045") ** 2)) < 1.5


def test_it_is_said_that_the_grain_counts_as_unchanged(capsys: pytest.CaptureFixture[str], cases: list[tuple[str, str]]) -> None:
    known, sweeps = cases[0]
    said = "the grain counts as unchanged since its calibration"
    for words, expected in (([], True), (["--drift", "friction=0.045"], False)):
        assert main(["self-calibrate", sweeps, "--params", known, *words]) == 0
        assert (said in capsys.readouterr().out) == expected


@pytest.mark.parametrize(
    ("drift", "problem"),
    [
        ("friction", "is 'friction'; expected NAME=VALUE"),
        ("friction=0", "friction is 0; expected a number above 0"),
        ("shape_ratio=0.1", "shape_ratio is not a parameter with a variance; expected one of friction, density, restitution"),
    ],
)
def test_changes_refused(capsys: pytest.CaptureFixture[str], cases: list[tuple[str, str]], drift: str, problem: str) -> None:
    known, sweeps = cases[0]
    capsys.readouterr()
    assert main(["self-calibrate", sweeps, "--params", known, "--drift", drift]) == 2
    assert capsys.readouterr().err == f"yieldmon: --drift: {problem}\n"
