"""Start states: every grain clear of its neighbours and the walls, mass exact, turning with the paddle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from studies.dem.clump import sphere_centres_m
from studies.dem.job import Throw, kernel_defaults, merged, throw_from_dict
from studies.dem.packing import start_packing
from studies.dem.records import paddle_frame

ANGLE = 2.0


@pytest.mark.parametrize("load_kg", [0.01, 0.2, 0.9, 1.8, 2.7])
@pytest.mark.parametrize("seed", [0, 5])
def test_loose_start(load_kg: float, seed: int) -> None:
    throw = Throw(paddle_mass_kg=load_kg, seed=seed)
    packing = start_packing(throw, ANGLE)
    assert packing.mass_kg.sum() == pytest.approx(load_kg, rel=1e-12)
    pairs = cKDTree(packing.position_m).query_pairs(2.0 * packing.radius_m.max(), output_type="ndarray")
    gaps = np.linalg.norm(packing.position_m[pairs[:, 0]] - packing.position_m[pairs[:, 1]], axis=1)
    assert np.all(gaps >= packing.radius_m[pairs].sum(axis=1))
    along, ahead = paddle_frame(packing.position_m, ANGLE)
    assert np.all(ahead > packing.radius_m)
    assert np.all(np.hypot(along, ahead) + packing.radius_m < throw.machine.paddle_length_m)
    assert np.all(np.abs(packing.position_m[:, 2]) + packing.radius_m < 0.5 * throw.machine.paddle_width_m)
    spin = np.cross([0.0, 0.0, throw.elevator_speed_rad_s], packing.position_m)
    np.testing.assert_allclose(packing.velocity_m_s, spin, atol=1e-12)


@pytest.mark.parametrize("load_kg", [0.01, 0.5, 1.3, 1.5])
def test_loose_start_of_clumps(load_kg: float) -> None:
    """Every sphere clear of those of other clumps and of the walls, each clump at an orientation of its own."""
    throw = throw_from_dict(merged(kernel_defaults("clump"), {"paddle_mass_kg": load_kg, "seed": 5}))
    packing = start_packing(throw, ANGLE)
    assert packing.mass_kg.sum() == pytest.approx(load_kg, rel=1e-12)
    shape = throw.grain.clump
    assert shape is not None
    assert packing.orientation is not None
    scale = packing.radius_m / throw.grain.radius_m
    centre = sphere_centres_m(shape, packing.position_m, packing.orientation, scale).reshape(-1, 3)
    radius = np.outer(scale, shape.radius_m).ravel()
    body = np.repeat(np.arange(throw.grain_count), shape.count)
    pairs = cKDTree(centre).query_pairs(2.0 * radius.max(), output_type="ndarray")
    pairs = pairs[body[pairs[:, 0]] != body[pairs[:, 1]]]
    gaps = np.linalg.norm(centre[pairs[:, 0]] - centre[pairs[:, 1]], axis=1)
    assert np.all(gaps >= radius[pairs].sum(axis=1))
    along, ahead = paddle_frame(centre, ANGLE)
    in_front = along > 0.0
    assert np.all(ahead[in_front] > radius[in_front])
    assert np.all(np.hypot(along, ahead) + radius < throw.machine.paddle_length_m)
    assert np.all(np.abs(centre[:, 2]) + radius < 0.5 * throw.machine.paddle_width_m)
    assert np.ptp(packing.orientation[:, 2, 2]) > 1.0


def test_the_seed_is_the_only_chance() -> None:
    throw = Throw(paddle_mass_kg=0.1, seed=3)
    first, again, other = start_packing(throw, ANGLE), start_packing(throw, ANGLE), start_packing(replace(throw, seed=4), ANGLE)
    assert np.array_equal(first.position_m, again.position_m)
    assert not np.array_equal(first.position_m, other.position_m)


def test_a_load_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="places ahead of the paddle"):
        start_packing(Throw(paddle_mass_kg=3.0), ANGLE)
