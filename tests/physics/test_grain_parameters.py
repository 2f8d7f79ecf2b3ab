"""Grain parameters are declared once: a new one reaches model, files, options, calibration, drift and configuration."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from yieldmon.estimation.priors import physical_bounds, search_bounds, start_ranges
from yieldmon.files.parameter_file import GRAIN_LIMITS
from yieldmon.physics import grain

ROOT = Path(__file__).parents[2]

NEW_PARAMETER = """    GrainParameter(
        name="cushioning", symbol="c", unit="", label="cushioning",
        limits=(0.0, 0.9), search=(0.0, 0.9), start=(0.0, 0.5), typical=0.1, step=0.1, default=0.0, drift=Drift(0.01, 0.01, 0.3),
    ),
)  # fmt: skip

GRAIN: """
EDITS = {
    "yieldmon/physics/grain.py": (")  # fmt: skip\n\nGRAIN: ", NEW_PARAMETER),
    "yieldmon/physics/impact.py": (
        "    return Impulse(arrival, gain,",
        '    gain = gain * (1.0 - setting.grain["cushioning"])\n    return Impulse(arrival, gain,',
    ),
}
PROGRAM = """
import json, sys
from pathlib import Path
import numpy as np
from yieldmon.estimation.fitting.calibration import calibrate, default_start
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.files import parameter_file
from yieldmon.physics.grain import fitted
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.service.config.document_text import commented_defaults

model = ForwardModel(Machine())
truth = {"friction": 0.3, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.5, "cushioning": 0.2}
at = Conditions(np.radians(np.repeat([50.0, 60.0, 70.0, 80.0], 3)), 42.0, mass_flow_kg_s=np.tile([3.0, 8.0, 14.0], 4))
rows = Measurements(at, np.real(model.paddle_momentum(at, truth)))
start = default_start(model, rows, ("restitution",), {"restitution": 0.5})
found = calibrate(model, rows, start, ("friction", "density", "cushioning"), starts=4, intervals=False)
parameter_file.save(found.parameter_set, sys.argv[1])
old = {name: value for name, value in truth.items() if name != "cushioning"}
print(json.dumps({
    "found": found.parameter_set.values["cushioning"],
    "read": parameter_file.load(sys.argv[1]).values["cushioning"],
    "fitted": fitted("restitution"),
    "without": float(np.real(model.paddle_momentum(at, old))[0] / rows.momentum[0]),
    "keys": commented_defaults().count("cushioning:"),
}))
"""


def test_a_new_crop_parameter_takes_two_files(tmp_path: Path) -> None:
    for part in ("yieldmon", "config", "dbc"):
        shutil.copytree(ROOT / part, tmp_path / part)
    assert len(EDITS) <= 3
    for name, (old, new) in EDITS.items():
        path = tmp_path / name
        text = path.read_text(encoding="utf-8")
        assert text.count(old) == 1, name
        path.write_text(text.replace(old, new), encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}

    def run(*command: str) -> str:
        done = subprocess.run(
            [sys.executable, *command], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    said = json.loads(run("-c", PROGRAM, str(tmp_path / "fitted.yaml")))
    assert said["found"] == pytest.approx(0.2, abs=1e-6)
    assert said["read"] == said["found"]
    assert "cushioning" in said["fitted"]
    assert said["without"] == pytest.approx(1.0 / 0.8)
    assert said["keys"] == 4
    verb = ("-m", "yieldmon.cli.main", "predict", "--mass-flow", "8", "--plate-angle", "70", "--json")
    plain, cushioned = (json.loads(run(*verb, *more))["rows"] for more in ((), ("--set", "cushioning=0.5")))
    assert cushioned[0]["force_n"] == pytest.approx(0.5 * plain[0]["force_n"])


@pytest.mark.parametrize("name", list(grain.GRAIN))
def test_ranges_nest(name: str) -> None:
    (least, most), (low, high), (first, last) = physical_bounds(name), search_bounds(name), start_ranges([name])[name]
    assert least <= low <= first < last <= high <= most
    assert low <= grain.GRAIN[name].typical <= high
    assert GRAIN_LIMITS[name][1] <= least < most <= GRAIN_LIMITS[name][2]


def test_published_signals() -> None:
    assert grain.published({"friction": 0.3, "density": 900.0, "restitution": 0.5}) == {"Friction": 0.3, "ImpactGain": 1.5}
    assert grain.published({"friction": 0.3, "k1": -0.2, "k2": 1.4})["ImpactGain"] == pytest.approx(1.2)


def test_exchange_coefficients_drift_with_the_restitution() -> None:
    assert grain.drift_key("k1") == grain.drift_key("k2") == "restitution"
    assert grain.drift_key("density") == "density"
