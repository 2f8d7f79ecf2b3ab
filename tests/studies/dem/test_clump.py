"""The clumped kernel's geometry and motion, against chance, closed forms and the equations of a rigid body."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from studies.dem import clump

SEED = 713
SHAPE = clump.published_clump()


def test_a_sphere_by_quadrature() -> None:
    volume, centre, second = clump.union_moments(np.array([[1.0, -2.0, 0.0]]), np.array([0.5]))
    assert volume == pytest.approx(pi / 6.0, rel=1e-4)
    np.testing.assert_allclose(centre, [1.0, -2.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(second, 0.2 * 0.25, rtol=1e-4)


def test_two_spheres_share_a_lens_once() -> None:
    distance, radius = 0.7, 0.5
    lens = pi * (4.0 * radius + distance) * (2.0 * radius - distance) ** 2 / 12.0
    volume, centre, _ = clump.union_moments(np.array([[0.0, 0.0, 0.0], [0.0, distance, 0.0]]), np.array([radius, radius]))
    assert volume == pytest.approx(pi / 3.0 - lens, rel=1e-4)
    assert centre[1] == pytest.approx(0.5 * distance)


def test_the_published_kernel_as_chance_has_it() -> None:
    """Volume and moments of inertia from points thrown at the union's box; a million know the volume to 0.08 %."""
    rng = np.random.default_rng(SEED)
    low, high = (SHAPE.centre_m - SHAPE.radius_m[:, None]).min(axis=0), (SHAPE.centre_m + SHAPE.radius_m[:, None]).max(axis=0)
    count = 1_000_000
    points = rng.uniform(low, high, (count, 3))
    distance = np.stack([((points - c) ** 2).sum(axis=1) / r**2 for c, r in zip(SHAPE.centre_m, SHAPE.radius_m, strict=True)])
    points = points[distance.min(axis=0) <= 1.0]
    assert len(points) / count * np.prod(high - low) == pytest.approx(3.001e-7, rel=3e-3)
    assert pytest.approx(3.001e-7, rel=2e-4) == SHAPE.volume_m3
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-5)
    second = (points**2).mean(axis=0)
    np.testing.assert_allclose(SHAPE.inertia_m2, second.sum() - second, rtol=4e-3)


def test_it_is_as_large_as_a_kernel() -> None:
    low, high = (SHAPE.centre_m - SHAPE.radius_m[:, None]).min(axis=0), (SHAPE.centre_m + SHAPE.radius_m[:, None]).max(axis=0)
    np.testing.assert_allclose(high - low, [9.2e-3, 10.072e-3, 6.0e-3], rtol=1e-3)
    assert SHAPE.reach_m < 6.0e-3
    assert sorted(set(SHAPE.radius_m)) == [2.5e-3, 3.0e-3]


def test_the_spheres_masses_have_the_bodys_centre() -> None:
    assert SHAPE.mass_share.sum() == pytest.approx(1.0, abs=1e-15)
    assert np.all(SHAPE.mass_share > 0.0)
    np.testing.assert_allclose(SHAPE.mass_share @ SHAPE.centre_m, 0.0, atol=1e-12)


@pytest.mark.parametrize("factor", [0.5, 1.05])
def test_scaling(factor: float) -> None:
    larger = clump.clump_of_volume(SHAPE.volume_m3 * factor**3)
    np.testing.assert_allclose(larger.radius_m, factor * SHAPE.radius_m)
    np.testing.assert_allclose(larger.inertia_m2, factor**2 * SHAPE.inertia_m2)
    assert larger.reach_m == pytest.approx(factor * SHAPE.reach_m)


def test_motion_is_read_back_from_the_spheres() -> None:
    """A body moved and turned at random: its axes, its angular velocity and its kinetic energy come back."""
    rng = np.random.default_rng(SEED)
    n = 50
    orientation = clump.random_orientations(n, rng)
    scale, mass = rng.uniform(0.9, 1.1, n), rng.uniform(3e-4, 5e-4, n)
    velocity, turning = rng.normal(0.0, 5.0, (n, 3)), rng.normal(0.0, 300.0, (n, 3))
    centre = rng.normal(0.0, 0.1, (n, 3))
    spheres = clump.sphere_centres_m(SHAPE, centre, orientation, scale)
    speeds = velocity[:, None, :] + np.cross(turning[:, None, :], spheres - centre[:, None, :])
    np.testing.assert_allclose(np.einsum("k,nkj->nj", SHAPE.mass_share, spheres), centre, atol=1e-12)
    np.testing.assert_allclose(clump.orientation_of(spheres), orientation, atol=1e-12)
    np.testing.assert_allclose(clump.turning_rad_s(SHAPE, spheres, speeds), turning, rtol=1e-9, atol=1e-8)
    body = np.einsum("nji,nj->ni", orientation, turning)
    energy = 0.5 * mass * ((velocity**2).sum(axis=1) + scale**2 * (body**2 @ SHAPE.inertia_m2))
    np.testing.assert_allclose(clump.kinetic_energy_j(SHAPE, mass, scale, spheres, speeds), energy, rtol=1e-9)


def test_orientations_are_even_over_the_sphere() -> None:
    matrices = clump.random_orientations(20_000, np.random.default_rng(SEED))
    np.testing.assert_allclose(np.linalg.det(matrices), 1.0, atol=1e-12)
    np.testing.assert_allclose(matrices.mean(axis=0), 0.0, atol=0.02)
    np.testing.assert_allclose((matrices**2).mean(axis=0), 1.0 / 3.0, atol=0.01)


def test_inertia_turns_with_the_body() -> None:
    quarter = Rotation.from_euler("z", 90.0, degrees=True).as_matrix()[None]
    tensor = clump.inertia_kg_m2(SHAPE, np.array([2.0]), quarter, np.array([1.0]))[0]
    x, y, z = 2.0 * SHAPE.inertia_m2
    np.testing.assert_allclose(tensor, np.diag([y, x, z]), atol=1e-18)
