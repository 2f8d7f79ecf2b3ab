"""A throw that is given another one's way of the grain reads the same bits as one that finds it by itself."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.open_loop import invert_force
from yieldmon.physics.effects import get_effect, registry
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import chebyshev_points

GRAIN = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55}
ANGLES, SPEEDS = np.radians([45.0, 70.0, 90.0])[:, None], np.array([33.0, 42.0, 50.0])[:, None]
GRID = chebyshev_points(24)
FORCES = np.array([8.0, 40.0, 75.0])
MOVED = {
    "density": ("density", 900.0),
    "gain": ("restitution", 0.3),
    "friction": ("friction", 0.3),
    "the heap's shape": ("shape_ratio", 2.4),
}


def values_of(model: ForwardModel) -> dict[str, float]:
    """With each effect at a size at which it shows."""
    found = dict(GRAIN)
    for name in model.effects:
        for parameter in get_effect(name).parameters:
            found[f"{name}.{parameter.name}"] = parameter.typical
    return found


def throw(model: ForwardModel, values: dict[str, float], like=None):
    return model.throw(ANGLES, SPEEDS, values, np.full(SPEEDS.shape, 17.0), like=like)


@pytest.mark.parametrize("effect", [None, *sorted(registry())])
def test_the_same_bits(effect: str | None) -> None:
    model = ForwardModel(Machine(), [] if effect is None else [effect])
    values = values_of(model)
    before = throw(model, values)
    near = throw(model, values, before)
    near.load_curve(GRID)
    of_effect = {name: (name, 0.7 * value) for name, value in values.items() if name not in GRAIN}
    for name, value in (MOVED | of_effect).values():
        alone = throw(model, values | {name: value})
        for like in (before, near):
            beside = throw(model, values | {name: value}, like)
            assert beside.miss_rotation_rad.tobytes() == alone.miss_rotation_rad.tobytes(), name
            for _ in range(2):
                for found, expected in zip(beside.load_curve(GRID), alone.load_curve(GRID), strict=True):
                    assert found.tobytes() == expected.tobytes(), name
            for found, expected in zip(invert_force(beside, FORCES), invert_force(alone, FORCES), strict=True):
                assert found.tobytes() == expected.tobytes(), name


def test_another_angle_is_another_way() -> None:
    model = ForwardModel(Machine(), [])
    before = throw(model, GRAIN)
    beside = model.throw(ANGLES + 0.02, SPEEDS, GRAIN, like=throw(model, GRAIN, before))
    alone = model.throw(ANGLES + 0.02, SPEEDS, GRAIN)
    assert beside.load_curve(GRID)[1].tobytes() == alone.load_curve(GRID)[1].tobytes()


def test_a_perturbation_is_carried_all_the_same() -> None:
    model = ForwardModel(Machine(), [])
    near = throw(model, GRAIN, throw(model, GRAIN))
    near.load_curve(GRID)
    for name in ("density", "friction"):
        moved = GRAIN | {name: np.asarray(GRAIN[name] + 1e-30j)}
        for like in (near, throw(model, moved, near)):
            beside, alone = throw(model, moved, like), throw(model, moved)
            assert beside.load_curve(GRID)[1].tobytes() == alone.load_curve(GRID)[1].tobytes()


@pytest.mark.parametrize("angles_rad", [np.radians(70.0), ANGLES[:, 0]], ids=["one setting", "several"])
def test_frictions_that_occur_twice_are_followed_once(angles_rad) -> None:
    model = ForwardModel(Machine(), [])
    frictions = np.array([0.2, 0.3, 0.2, 0.25, 0.3])
    sets = frictions.reshape(-1, *np.ones(np.ndim(angles_rad), dtype=int))
    together = model.throw(angles_rad, 42.0, GRAIN | {"friction": sets}).miss_rotation_rad
    assert together.shape == (5, *np.shape(angles_rad), 1)
    for found, friction in zip(together, frictions, strict=True):
        alone = model.throw(angles_rad, 42.0, GRAIN | {"friction": friction}).miss_rotation_rad
        assert found.tobytes() == alone.tobytes()
