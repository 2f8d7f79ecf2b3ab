"""The published clumped kernel: overlapping spheres that move as one body.

Published are the spheres' radii (2.5 and 3.0 mm), the kernel's mass and its volume, not how many spheres there are nor where
("Self-Calibrating Mass Flow Sensor", Univ. of Illinois / Deere, table 11.8). The layout here is an assumption: two large spheres
side by side as the crown and two small ones as the tip, all centres in one plane, the rows so far apart that the union has the
published volume. The body's own axes are x across, y from crown to tip, z across the flat side; by symmetry they are principal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

LARGE_RADIUS_M = 3.0e-3
SMALL_RADIUS_M = 2.5e-3
CROWN_SPACING_M = 3.2e-3
TIP_SPACING_M = 2.6e-3
ROW_SPACING_M = 4.572e-3
"""Makes the union 3.001e-7 m3, with the two spacings above."""
QUADRATURE_CELLS = 1200


@dataclass(frozen=True, slots=True)
class Clump:
    """k spheres about their body's centre of mass, in the body's own axes.

    centre_m: (k, 3). radius_m: (k,). volume_m3: of the union. inertia_m2: (3,) principal moments of the union, filled evenly, per
    unit of mass. mass_share: (k,) shares of the body's mass which, put into the spheres' centres, have its centre of mass.
    """

    centre_m: Array
    radius_m: Array
    volume_m3: float
    inertia_m2: Array
    mass_share: Array

    @property
    def count(self) -> int:
        """Spheres in the clump."""
        return len(self.radius_m)

    @property
    def reach_m(self) -> float:
        """Distance of the farthest point from the centre of mass, m."""
        return float((np.linalg.norm(self.centre_m, axis=1) + self.radius_m).max())

    def scaled(self, factor: float) -> Clump:
        """The same shape, `factor` times as long."""
        return Clump(
            self.centre_m * factor,
            self.radius_m * factor,
            self.volume_m3 * factor**3,
            self.inertia_m2 * factor**2,
            self.mass_share,
        )


def union_moments(centre_m: Array, radius_m: Array, cells: int = QUADRATURE_CELLS) -> tuple[float, Array, Array]:
    """Volume, centre (3,) and second moments (x2, y2, z2) about that centre per unit of volume, of spheres centred on z = 0.

    Above a point of that plane the union is as high as the highest of its spheres; it is summed over cells x cells points.
    """
    low, high = (centre_m[:, :2] - radius_m[:, None]).min(axis=0), (centre_m[:, :2] + radius_m[:, None]).max(axis=0)
    step = (high - low) / cells
    x, y = (low[i] + (np.arange(cells) + 0.5) * step[i] for i in range(2))
    square = np.zeros((cells, cells))
    for c, r in zip(centre_m, radius_m, strict=True):
        np.maximum(square, r**2 - ((x - c[0]) ** 2)[:, None] - ((y - c[1]) ** 2)[None, :], out=square)
    height = np.sqrt(square)
    weight = 2.0 * height * step.prod()
    volume = float(weight.sum())
    along_x, along_y = weight.sum(axis=1) / volume, weight.sum(axis=0) / volume
    centre = np.array([along_x @ x, along_y @ y, 0.0])
    second = np.array(
        [
            along_x @ (x - centre[0]) ** 2,
            along_y @ (y - centre[1]) ** 2,
            float((weight * square).sum()) / (3.0 * volume),
        ]
    )
    return volume, centre, second


@cache
def published_clump() -> Clump:
    """The kernel of the validation runs, 3.001e-7 m3, in the layout assumed here."""
    across = np.array([-0.5 * CROWN_SPACING_M, 0.5 * CROWN_SPACING_M, -0.5 * TIP_SPACING_M, 0.5 * TIP_SPACING_M])
    down = np.array([0.0, 0.0, ROW_SPACING_M, ROW_SPACING_M])
    centre = np.column_stack([across, down, np.zeros(4)])
    radius = np.array([LARGE_RADIUS_M, LARGE_RADIUS_M, SMALL_RADIUS_M, SMALL_RADIUS_M])
    volume, middle, second = union_moments(centre, radius)
    tip = float(middle[1]) / ROW_SPACING_M
    share = 0.5 * np.array([1.0 - tip, 1.0 - tip, tip, tip])
    return Clump(centre - middle, radius, volume, second.sum() - second, share)


@cache
def clump_of_volume(volume_m3: float) -> Clump:
    """The published clump scaled to a volume."""
    shape = published_clump()
    return shape.scaled((volume_m3 / shape.volume_m3) ** (1.0 / 3.0))


def random_orientations(count: int, rng: np.random.Generator) -> Array:
    """Rotation matrices (count, 3, 3), evenly over all orientations; columns are the body's axes in space."""
    matrices: Array = Rotation.from_quat(rng.normal(size=(count, 4))).as_matrix()
    return matrices


def sphere_centres_m(shape: Clump, position_m: Array, orientation: Array, scale: Array) -> Array:
    """Where the spheres of n clumps are, (n, k, 3). position_m: (n, 3) centres of mass; orientation: (n, 3, 3); scale: (n,)."""
    centres: Array = position_m[:, None, :] + scale[:, None, None] * np.einsum("nij,kj->nki", orientation, shape.centre_m)
    return centres


def inertia_kg_m2(shape: Clump, mass_kg: Array, orientation: Array, scale: Array) -> Array:
    """Inertia tensors (n, 3, 3) in space."""
    principal = (mass_kg * scale**2)[:, None] * shape.inertia_m2
    tensor: Array = np.einsum("nij,nj,nkj->nik", orientation, principal, orientation)
    return tensor


def orientation_of(sphere_position_m: Array) -> Array:
    """Rotation matrices (n, 3, 3) from the spheres' centres (n, 4, 3): across the crown, from crown to tip, and their normal."""
    x = sphere_position_m[:, 1] - sphere_position_m[:, 0]
    y = sphere_position_m[:, 2:].sum(axis=1) - sphere_position_m[:, :2].sum(axis=1)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=2)


def turning_rad_s(shape: Clump, sphere_position_m: Array, sphere_velocity_m_s: Array) -> Array:
    """Angular velocities (n, 3) from the spheres' centres and velocities (n, 4, 3)."""
    axes = orientation_of(sphere_position_m)
    centre = np.einsum("k,nkj->nj", shape.mass_share, sphere_velocity_m_s)
    relative = sphere_velocity_m_s - centre[:, None, :]
    # Velocity is turning x arm; with arms along the body's x and y, each of its three parts is read off directly.
    across = 0.5 * (relative[:, 1] - relative[:, 0])
    half = 0.5 * np.linalg.norm(sphere_position_m[:, 1] - sphere_position_m[:, 0], axis=1)
    down = 0.5 * (relative[:, 2] + relative[:, 3] - relative[:, 0] - relative[:, 1])
    rows = 0.5 * np.linalg.norm(sphere_position_m[:, 2:].sum(axis=1) - sphere_position_m[:, :2].sum(axis=1), axis=1)
    about_x = np.einsum("ni,ni->n", down, axes[:, :, 2]) / rows
    about_y = -np.einsum("ni,ni->n", across, axes[:, :, 2]) / half
    about_z = np.einsum("ni,ni->n", across, axes[:, :, 1]) / half
    turning: Array = np.einsum("nij,nj->ni", axes, np.stack([about_x, about_y, about_z], axis=1))
    return turning


def kinetic_energy_j(shape: Clump, mass_kg: Array, scale: Array, sphere_position_m: Array, sphere_velocity_m_s: Array) -> Array:
    """Kinetic energy (n,) of n clumps, turning included, from their spheres' centres and velocities (n, 4, 3)."""
    velocity = np.einsum("k,nkj->nj", shape.mass_share, sphere_velocity_m_s)
    turning = turning_rad_s(shape, sphere_position_m, sphere_velocity_m_s)
    inertia = inertia_kg_m2(shape, mass_kg, orientation_of(sphere_position_m), scale)
    energy: Array = 0.5 * mass_kg * (velocity**2).sum(axis=1) + 0.5 * np.einsum("ni,nij,nj->n", turning, inertia, turning)
    return energy
