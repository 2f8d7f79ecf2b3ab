"""Rows made by the study's own generator, which shares no code with the forward model."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from studies.hidden_effects import generator
from yieldmon.discrepancy.observations import Rows, with_cells
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine

GRAIN = generator.Grain(friction=0.3, restitution=0.55, density=1150.0)
FLOWS_KG_S = (1.5, 5.0, 10.0, 18.0)
ANGLES_DEG = tuple(np.arange(40.0, 91.0, 10.0))
START = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.6}


@lru_cache
def forces_n(speeds_rpm: tuple[float, ...], effects: tuple[tuple[str, float], ...]) -> np.ndarray:
    """By speed, flow and angle, without noise: most tests look at the same few machines."""
    speed, flow, angle = np.meshgrid(np.array(speeds_rpm) * generator.RPM, FLOWS_KG_S, np.radians(ANGLES_DEG), indexing="ij")
    rows = (angle.ravel(), speed.ravel(), flow.ravel(), np.full(angle.size, 15.0))
    force = generator.force(*rows, GRAIN, dict(effects)).reshape(angle.shape)
    force.flags.writeable = False
    return force


@pytest.fixture(scope="session")
def start() -> ParameterSet:
    return ParameterSet(values=START)


@pytest.fixture(scope="session")
def make_rows() -> Callable[..., Rows]:
    """make_rows(effects, seed=, noise=, speeds_rpm=, repeats=, alter=): 6 angles x 4 flows x speeds x repeats."""

    def make(
        effects: dict[str, float] | None = None,
        *,
        seed: int = 5,
        noise: float = 0.01,
        speeds_rpm: tuple[float, ...] = (340.0, 400.0, 460.0),
        repeats: int = 3,
        alter: Callable[..., np.ndarray] | None = None,
    ) -> Rows:
        speed, flow, repeat, angle = (
            a.ravel()
            for a in np.meshgrid(
                np.array(speeds_rpm) * generator.RPM,
                FLOWS_KG_S,
                np.arange(repeats),
                np.radians(ANGLES_DEG),
                indexing="ij",
            )
        )
        moisture = np.full(angle.shape, np.nan)
        once = forces_n(speeds_rpm, tuple((effects or {}).items()))
        force = np.repeat(once[:, :, None, :], repeats, axis=2).ravel()
        if alter is not None:
            force = alter(force, angle, speed, flow)
        sd = noise * np.hypot(np.abs(force), 0.1 * np.max(force))
        force = force + sd * np.random.default_rng(seed).standard_normal(force.shape)
        return with_cells(
            Rows(
                Machine(),
                "mass_flow_kg_s",
                "force",
                True,
                angle,
                speed,
                flow,
                moisture,
                force,
                np.full(angle.shape, np.nan),
                tuple(str(int(r)) for r in repeat),
                np.zeros(angle.size, dtype=np.int64),
            )
        )

    return make
