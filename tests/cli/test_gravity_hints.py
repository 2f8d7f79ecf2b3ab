"""A table of a machine on which gravity acts, as on all, and models without it: what calibrate and diagnose say of that."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from yieldmon.cli.main import main
from yieldmon.physics.effects import registry

ANGLES_DEG, FLOWS_KG_S, REPEATS = (50, 60, 70, 80), (4, 8, 12, 16), 3
SEED = 203
#: What is said of the given effects does not depend on which others are looked for.
FEW = [word for name in registry() if name not in ("gravity", "zero_offset") for word in ("--without", name)]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Forces of the shipped corn, with gravity, 2 % of noise: a model without gravity fits them with F of about 5."""
    from yieldmon.api import ForwardModel, load_machine, load_parameters
    from yieldmon.physics.machine import RPM
    from yieldmon.physics.model import Conditions

    machine, known = load_machine(), load_parameters()
    angle, flow = (axis.ravel() for axis in np.meshgrid(np.repeat(ANGLES_DEG, REPEATS), FLOWS_KG_S, indexing="ij"))
    speed = np.full(angle.shape, 400.0 * RPM)
    there = Conditions(np.radians(angle), speed, mass_flow_kg_s=flow.astype(float))
    force = ForwardModel(machine, known.effects).paddle_momentum(there, known.values) * machine.passes_per_s(speed)
    force = force * np.random.default_rng(SEED).normal(1.0, 0.02, force.shape)
    path = tmp_path_factory.mktemp("gravity") / "table.csv"
    rows = [f"{a},{f},{n:.4f}" for a, f, n in zip(angle, flow, force, strict=True)]
    path.write_text("\n".join(("plate_angle_deg,mass_flow_kg_s,force_n", *rows)) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("options", "said"), [([], True), (["--effects", "gravity"], False)], ids=["without", "with"])
def test_calibrate_says_what_may_be_missing(
    options: list[str], said: bool, table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", str(table), "--starts", "3", *options]) == 0
    out = capsys.readouterr().out
    assert ("the model may miss something" in out) is said
    assert ("--effects gravity" in out) is said


@pytest.mark.parametrize(("options", "said"), [([], True), (["--keep-effects"], False)], ids=["dropped", "kept"])
def test_diagnose_says_which_of_the_given_effects_it_looks_for(
    options: list[str], said: bool, table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", str(table), "--params", "corn", *FEW, *options]) == 0
    assert ("corn.yaml has gravity, searched for here" in capsys.readouterr().err) is said
