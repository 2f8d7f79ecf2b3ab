"""Every further law of an effect: nothing at its null value, a smooth change beyond, and a family that exists."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.physics.effects import family_of, get_effect, laws, registry
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import COMPLEX_STEP

FURTHER = tuple(law for name in registry() for law in laws(name)[1:])
GRAIN = {"friction": 0.3, "density": 1150.0, "shape_ratio": 2.0, "restitution": 0.5, "gravity.acceleration_m_s2": 9.81}
ANGLE, SPEED, FLOW = np.meshgrid(
    np.radians([40.0, 55.0, 70.0, 90.0]), np.array([340.0, 460.0]) * RPM, [2.0, 8.0, 16.0], indexing="ij"
)
CONDITIONS = Conditions(ANGLE.ravel(), SPEED.ravel(), mass_flow_kg_s=FLOW.ravel())


def _force(name: str, sizes: dict[str, complex]) -> np.ndarray:
    effects = ("gravity", name) if name else ("gravity",)
    return np.asarray(ForwardModel(Machine(), effects).force(CONDITIONS, GRAIN | sizes, overfull="nan"))


def _sizes(name: str, kind: str) -> dict[str, float]:
    return {f"{name}.{p.name}": getattr(p, kind) for p in get_effect(name).parameters}


def test_there_are_some() -> None:
    assert len(FURTHER) >= 10


@pytest.mark.parametrize("name", FURTHER)
def test_a_law_belongs_to_an_effect_and_says_how_it_differs(name: str) -> None:
    law = get_effect(name)
    assert law.family == family_of(name)
    assert law.family in registry()
    assert name not in registry()
    assert law.law
    assert law.stage == registry()[law.family].stage
    assert law.source != registry()[law.family].source


@pytest.mark.parametrize("name", FURTHER)
def test_nothing_at_its_null_and_something_at_its_typical_size(name: str) -> None:
    plain = _force("", {})
    np.testing.assert_allclose(_force(name, _sizes(name, "null")), plain, rtol=1e-6)
    changed = _force(name, _sizes(name, "typical"))
    assert np.nanmax(np.abs(changed - plain)) > 0.003 * np.nanmax(plain)
    other = _force(family_of(name), _sizes(family_of(name), "typical"))
    assert not np.allclose(changed, other, rtol=1e-3)


@pytest.mark.parametrize("name", FURTHER)
def test_its_derivative_is_the_one_of_differences(name: str) -> None:
    sizes = _sizes(name, "typical")
    (leading, *_) = sizes
    step = 1e-5 * sizes[leading]
    up, down = _force(name, sizes | {leading: sizes[leading] + step}), _force(name, sizes | {leading: sizes[leading] - step})
    slope = np.imag(_force(name, sizes | {leading: sizes[leading] + 1j * COMPLEX_STEP})) / COMPLEX_STEP
    scale = np.nanmax(np.abs(slope))
    np.testing.assert_allclose(slope / scale, (up - down) / (2.0 * step) / scale, atol=2e-3)
