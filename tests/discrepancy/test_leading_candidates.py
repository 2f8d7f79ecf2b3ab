"""Leading candidates unlike the cases on which confidence was fitted have none."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from yieldmon.cli.main import main
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

GRAIN = {"friction": 0.3, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.5}
ANGLES_DEG = (42.0, 50.0, 58.0, 66.0, 74.0, 82.0, 90.0)
FLOWS_KG_S = (2.0, 5.0, 9.0, 14.0, 19.0)
OFFSET_N = 0.4
"""Noise beside the relative one, as of a cell's zero."""
_Law = Callable[[float, float], float]


def one_angle_reads_more(angle_deg: float, flow_kg_s: float) -> float:
    """Readings at one angle are off."""
    return 1.15 if angle_deg == 66.0 else 1.0


def none(angle_deg: float, flow_kg_s: float) -> float:
    """The published model."""
    return 1.0


def table(path: Path, law: _Law, noise: float, late_rad: float) -> str:
    """Three readings at each angle and flow. late_rad: of the release."""
    rng, lines = np.random.default_rng(7), ["plate_angle_deg,mass_flow_kg_s,force_n"]
    model = ForwardModel(Machine(), ("release_angle",))
    for flow in FLOWS_KG_S:
        at = Conditions(np.radians(ANGLES_DEG), 400.0 * RPM, mass_flow_kg_s=flow)
        force = model.force(at, GRAIN | {"release_angle.angle_rad": late_rad})
        for angle, newtons in zip(ANGLES_DEG, force, strict=True):
            for scatter, offset in rng.normal(0.0, (noise, OFFSET_N), (3, 2)):
                lines.append(f"{angle},{flow},{newtons * law(angle, flow) * (1.0 + scatter) + offset}")
    path.write_text("\n".join(lines) + "\n")
    return str(path)


@pytest.mark.parametrize(
    ("law", "noise", "late_rad"),
    [(one_angle_reads_more, 0.01, 0.0), (none, 0.25, 0.3)],
    ids=["candidates that explain nothing", "scatter of 25 %"],
)
def test_no_confidence_is_stated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], law: _Law, noise: float, late_rad: float
) -> None:
    words = ["diagnose", table(tmp_path / "rows.csv", law, noise, late_rad)]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] == "unknown"
    assert [(one["confidence"], one["name_confidence"]) for one in found["leading"]] == [(None, None)] * len(found["leading"])
    assert found["leading"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "(confidence not known" in out
    assert "of 100 cases" not in out
