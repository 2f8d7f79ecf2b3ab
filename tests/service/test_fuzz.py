"""The quick version of tests.robustness fuzz-frames (fuzz-config has its own beside the configuration's tests)."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from tests.in_process import program
from tests.robustness import fuzz_frames as tool
from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.engine.mass.loads import Loads
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.sweeps.plate_commands import PlateCommander
from yieldmon.service.config import configuration


def test_nothing_escapes():
    done = program("tests.robustness.__main__", "fuzz-frames", "--count", 60000, "--seed", 20261121, "--json")
    assert done.returncode == 0, done.stderr
    counts = json.loads(done.stdout)
    assert counts["escapes"] == 0
    assert counts["frames"] >= 60_000
    assert counts["malformed"] > 20
    assert counts["windows"] > 150
    assert counts["sweeps"] > 0


def runs_back(self: Totals, mass_kg: float, *_: object) -> Totals:
    return Totals(total_kg=(self.total_kg or 1000.0) - mass_kg)


def out_of_range(self: PlateCommander, demand: object, angle_deg: float) -> dict[str, frames.Value]:
    return {"TargetPlateAngle": 120.0, "CommandMode": 1, "CommandCounter": 0}


def negative(self: Loads, *_: object, **__: object) -> float:
    return -1.0


@pytest.mark.parametrize(
    ("owner", "name", "fault", "finding"),
    [
        (Totals, "with_mass", runs_back, "ran back"),
        (PlateCommander, "command", out_of_range, "commanded to 120"),
        (Loads, "count", negative, "mass_kg is -1.0"),
    ],
    ids=["total", "plate", "mass"],
)
def test_an_engine_that_is_wrong_is_found_out(monkeypatch, owner, name, fault, finding):
    monkeypatch.setattr(owner, name, fault)
    loaded = configuration.build(tool.SETTINGS, Path("fuzz.yaml"), {})
    rng = random.Random(3)  # brings grain and a sweep
    monkeypatch.setattr(tool, "RATES", (0.001,))
    with pytest.raises(tool.Escape, match=finding):
        tool.Fuzzer(Codec(), loaded, rng).live(tool.LIFE_FRAMES)
