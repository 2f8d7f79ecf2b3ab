"""The study's generator and the forward model were written apart; with nothing hidden they must agree."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from studies.hidden_effects import cases, generator
from yieldmon.physics.effects import registry
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel

ANGLE, FLOW, SPEED = (
    a.ravel()
    for a in np.meshgrid(np.radians([40.0, 55.0, 75.0, 90.0]), [1.0, 6.0, 15.0], np.array([350.0, 450.0]) * generator.RPM)
)
DRY = np.full(ANGLE.shape, 15.0)


@pytest.mark.parametrize(("friction", "restitution", "density"), [(0.1, 0.7, 900.0), (0.35, 0.5, 1200.0), (0.6, 0.3, 1500.0)])
def test_nothing_hidden_is_the_published_model(friction: float, restitution: float, density: float) -> None:
    made = generator.force(ANGLE, SPEED, FLOW, DRY, generator.Grain(friction, restitution, density), {})
    values = {"friction": friction, "restitution": restitution, "density": density, "shape_ratio": 2.0}
    model = ForwardModel(Machine()).force(Conditions(ANGLE, SPEED, mass_flow_kg_s=FLOW), values)
    np.testing.assert_allclose(made, model, rtol=3e-4)


@pytest.mark.parametrize("name", [n for n in cases.SIZES if n != "moisture_dependence"])
def test_each_effect_means_the_same_in_both(name: str) -> None:
    """Same sign and pattern; forms differ, so only the correlation of the changes is held."""
    size = cases.SIZES[name][1] * 0.5
    grain = generator.Grain(0.3, 0.6, 1100.0)
    change = generator.force(ANGLE, SPEED, FLOW, DRY, grain, {name: size}) - generator.force(ANGLE, SPEED, FLOW, DRY, grain, {})
    values = {"friction": 0.3, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
    at = Conditions(ANGLE, SPEED, mass_flow_kg_s=FLOW)
    moved = ForwardModel(Machine(), (name,)).force(at, values | {f"{name}.{cases.LEADING[name]}": size})
    expected = moved - ForwardModel(Machine()).force(at, values)
    assert change @ expected / np.linalg.norm(change) / np.linalg.norm(expected) > 0.97


def test_every_registered_effect_is_in_the_study() -> None:
    without_a_law_of_the_generators = {"heap_shape"}
    inferred = {name for name, effect in registry().items() if not effect.measured}
    assert set(cases.SIZES) == inferred - without_a_law_of_the_generators


def test_the_generator_imports_nothing_of_the_project() -> None:
    tree = ast.parse(Path(generator.__file__).read_text(encoding="utf-8"))
    modules = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    modules |= {n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert not any(name.startswith("yieldmon") for name in modules)
