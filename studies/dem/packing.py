"""Where the grains start: loose layers in a wedge ahead of the paddle, turning with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from studies.dem.clump import random_orientations
from studies.dem.job import Throw

GAP = 1.03
"""Distance of neighbours in the start lattice, in diameters of the largest grain."""
REACH_AHEAD_RAD = {"sphere": 2.0, "clump": 3.2}
"""How far ahead of the paddle grains may start; clumps lie at random and need more room."""


@dataclass(frozen=True, slots=True)
class Packing:
    """Start state of n grains. position_m, velocity_m_s: (n, 3) of their centres of mass; radius_m, mass_kg: (n,).

    radius_m is that of the sphere of the grain's volume. orientation: (n, 3, 3) of clumps, None for spheres.
    """

    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    mass_kg: NDArray[np.float64]
    orientation: NDArray[np.float64] | None = None


def start_packing(throw: Throw, paddle_angle_rad: float) -> Packing:
    """Grains without overlap ahead of a paddle at paddle_angle_rad, in rigid rotation with it.

    Masses add up to throw.paddle_mass_kg exactly: the density takes up what the whole number of grains leaves over. Raises
    ValueError when the load does not fit ahead of the paddle.
    """
    rng = np.random.default_rng(throw.seed)
    n = throw.grain_count
    machine, grain = throw.machine, throw.grain
    radius = grain.radius_m * (1.0 + grain.size_spread * rng.uniform(-1.0, 1.0, n))
    pitch = 2.0 * GAP * grain.reach_m * (1.0 + grain.size_spread)
    rho, psi, z = _lattice(machine.paddle_length_m, machine.paddle_width_m, pitch, REACH_AHEAD_RAD[grain.kernel])
    if len(rho) < n:
        raise ValueError(f"paddle_mass_kg is {throw.paddle_mass_kg}: {n} grains, but {len(rho)} places ahead of the paddle")
    wedge = (1.0 - rho / machine.paddle_length_m) + psi / throw.start_shape_ratio
    places = np.argsort(wedge, kind="stable")[:n]
    jitter = 0.5 * (GAP - 1.0) / GAP * pitch * rng.uniform(-0.5, 0.5, (n, 3))
    angle = paddle_angle_rad + psi[places]
    position = np.column_stack([rho[places] * np.cos(angle), rho[places] * np.sin(angle), z[places]]) + jitter
    spin = throw.elevator_speed_rad_s
    velocity = np.column_stack([-spin * position[:, 1], spin * position[:, 0], np.zeros(n)])
    volume = radius**3
    mass = throw.paddle_mass_kg * volume / volume.sum()
    orientation = None if grain.clump is None else random_orientations(n, rng)
    return Packing(position, velocity, radius, mass, orientation)


def _lattice(length_m: float, width_m: float, pitch_m: float, ahead_rad: float) -> tuple[NDArray[np.float64], ...]:
    """Places (rho, psi, z) on layers of constant radius, psi from the paddle up to ahead_rad."""
    across = max(1, int(width_m / pitch_m))
    z = (np.arange(across) - 0.5 * (across - 1)) * pitch_m
    rho_all, psi_all, z_all = [], [], []
    radius = length_m - 0.5 * pitch_m
    while radius > 3.0 * pitch_m:
        # Chords, not arcs, keep neighbours apart; the first grain clears the paddle's face by half a pitch.
        first = np.arcsin(0.5 * pitch_m / radius)
        step = 2.0 * np.arcsin(0.5 * pitch_m / radius)
        psi = np.arange(first, ahead_rad, step)
        grid = np.meshgrid(psi, z, indexing="ij")
        psi_all.append(grid[0].ravel())
        z_all.append(grid[1].ravel())
        rho_all.append(np.full(grid[0].size, radius))
        radius -= pitch_m
    return np.concatenate(rho_all), np.concatenate(psi_all), np.concatenate(z_all)
