"""The commands that LAMMPS is given, as lines of text: pure functions of the job.

The paddle is a thin block that turns about the sprocket's centre, the housing a full cylinder of the paddle's length with two
cheeks at its ends, the plate a thin block behind its face. Each wall acts on a group of its own. A grain is taken out of HOUSED
once it is released, so the cylinder need not be cut open; SWEPT and STRIKING hold the grains near the paddle and near the plate,
since a turned block is dear to ask about grains that are far from it.
"""

from __future__ import annotations

from math import pi
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from studies.dem.job import Throw

Array = NDArray[np.float64]

PADDLE_THICKNESS_M = 0.004
PLATE_THICKNESS_M = 0.006
HOUSED = "housed"
SWEPT = "swept"
STRIKING = "striking"
GROUPS = (HOUSED, SWEPT, STRIKING)
REACH_RADII = 3.0
"""A grain belongs to a wall's group when its centre is within this many mean radii of it."""
BOX_M = ((-0.25, 0.75), (-0.35, 0.35), (-0.25, 0.25))
"""Limits in x, y, z; a grain beyond them is dropped and counted as having left."""
LEAVING_M = 0.03
"""A clump this near to a limit is dropped whole: half a body is an error to the engine."""
LEAVING_STEPS = 25


def wall_modulus_pa(throw: Throw) -> float:
    """Young's modulus to give a wall fix, Pa.

    The engine takes a wall to be of the grain's kind, E* = E / (2 (1 - nu^2)); the value returned makes E* that of grain on wall.
    """
    g, w = throw.grain, throw.walls
    compliance = (1.0 - g.poisson**2) / g.youngs_modulus_pa + (1.0 - w.poisson**2) / w.youngs_modulus_pa
    return 2.0 * (1.0 - g.poisson**2) / compliance * throw.stiffness_factor


def contact_model(throw: Throw, youngs_modulus_pa: float) -> str:
    """The granular contact model, the same words for pairs and walls."""
    c = throw.contact
    return (
        f"hertz/material {youngs_modulus_pa!r} {c.restitution!r} {throw.grain.poisson!r} "
        f"tangential mindlin_rescale NULL 1.0 {c.friction!r} "
        f"rolling sds {c.rolling_stiffness_n_m!r} {c.rolling_damping_n_s_m!r} {c.rolling_friction!r} "
        "damping coeff_restitution"
    )


def world(throw: Throw) -> list[str]:
    """Units, box and pair law of an empty world."""
    (x0, x1), (y0, y1), (z0, z1) = BOX_M
    return [
        "units si",
        "atom_style sphere" if throw.grain.clump is None else "atom_style hybrid sphere bond",
        "atom_modify map array",
        "dimension 3",
        "boundary f f f",
        "newton off",
        "comm_modify vel yes",
        f"region box block {x0} {x1} {y0} {y1} {z0} {z1} units box",
        "create_box 1 box",
        *neighbours(throw),
        *pair_law(throw),
        *(f"group {name} empty" for name in GROUPS),
    ]


def pair_law(throw: Throw) -> list[str]:
    """Contact law between grains. It is said again after a restart: the restart file leaves some of its settings unset."""
    modulus = throw.grain.youngs_modulus_pa * throw.stiffness_factor
    return ["pair_style granular", f"pair_coeff * * {contact_model(throw, modulus)}"]


def neighbours(throw: Throw) -> list[str]:
    """Neighbour list and output settings, which a restart file does not carry. Spheres of one clump do not meet."""
    apart = "" if throw.grain.clump is None else " binsize 0.009 exclude molecule/intra all"
    return [
        "neighbor 0.003 bin",
        f"neigh_modify every 1 delay 0 check yes{apart}",
        "thermo_style custom step atoms",
        "thermo_modify lost ignore flush no",
        "thermo 1000000",
    ]


def motion(throw: Throw) -> list[str]:
    """Time step, gravity (down is +y), and the time integration of spheres; that of clumps is `bodies`."""
    lines = [f"timestep {throw.time_step_s!r}", f"fix weight all gravity {throw.gravity_m_s2!r} vector 0 1 0"]
    if throw.grain.clump is None:
        return [lines[0], "fix move all nve/sphere", lines[1]]
    inner = " ".join(f"{low + LEAVING_M!r} {high - LEAVING_M!r}" for low, high in BOX_M)
    return [
        *lines,
        f"region beyond block {inner} side out units box",
        f"fix leave all evaporate {LEAVING_STEPS} 1000000 beyond 1 molecule yes",
    ]


def bodies(state_file: Path) -> list[str]:
    """Time integration of clumps, from the bodies' state in a file.

    The engine's own moments of inertia take the spheres as apart; the file has the union's. A restart file does not carry the
    bodies; the engine writes them beside it, in a file of the same form.
    """
    return [f"fix move all rigid/small molecule infile {state_file}"]


def body_lines(
    mass_kg: Array, position_m: Array, velocity_m_s: Array, inertia_kg_m2: Array, angular_momentum_kg_m2_s: Array
) -> str:
    """The bodies' state file: mass (n,), centre of mass and its velocity (n, 3), inertia (n, 3, 3), angular momentum (n, 3)."""
    i = inertia_kg_m2
    table = np.column_stack(
        [
            mass_kg,
            position_m,
            i[:, 0, 0],
            i[:, 1, 1],
            i[:, 2, 2],
            i[:, 0, 1],
            i[:, 0, 2],
            i[:, 1, 2],
            velocity_m_s,
            angular_momentum_kg_m2_s,
        ]
    )
    rows = (f"{n} {' '.join(map(repr, map(float, row)))} 0 0 0" for n, row in enumerate(table, start=1))
    return "\n".join([str(len(table)), *rows, ""])


def machine_walls(throw: Throw, start_angle_rad: float) -> list[str]:
    """Paddle, housing and cheeks; the paddle points to start_angle_rad at step 0."""
    m = throw.machine
    model = contact_model(throw, wall_modulus_pa(throw))
    length, half = m.paddle_length_m, 0.5 * m.paddle_width_m
    turn = throw.elevator_speed_rad_s * throw.time_step_s
    return [
        f"variable paddle_angle equal {start_angle_rad!r}+{turn!r}*step",
        f"region paddle block 0.0 {length!r} {-PADDLE_THICKNESS_M} 0.0 {-half!r} {half!r} side out units box "
        "rotate v_paddle_angle 0 0 0 0 0 1",
        f"fix paddle {SWEPT} wall/gran/region granular {model} region paddle contacts",
        f"fix housing {HOUSED} wall/gran granular {model} zcylinder {length!r} contacts",
        f"fix cheeks {HOUSED} wall/gran granular {model} zplane {-half!r} {half!r}",
    ]


def plate_wall(throw: Throw, plate_angle_rad: float) -> list[str]:
    """The impact plate: a block below the x axis of its own frame, turned about its top edge by 180 deg less its angle.

    The plate runs from its top edge along (cos phi, sin phi); its face looks to the elevator, towards (-sin phi, cos phi).
    """
    m = throw.machine
    model = contact_model(throw, wall_modulus_pa(throw))
    x, y = m.plate_pivot_x_m, m.plate_pivot_y_m
    half = 0.5 * throw.plate_width_m
    return [
        f"variable plate_angle equal {plate_angle_rad!r}",
        f"region plate block {x!r} {x + m.plate_length_m!r} {y - PLATE_THICKNESS_M!r} {y!r} {-half!r} {half!r} "
        f"side out units box rotate v_plate_angle {x!r} {y!r} 0 0 0 1",
        f"fix plate {STRIKING} wall/gran/region granular {model} region plate contacts",
    ]


def start_angle_rad(throw: Throw) -> float:
    """Where the paddle points when the settled load is handed over: 162 deg, every heap still well inside the housing."""
    return 0.9 * pi


def settle_steps(throw: Throw) -> int:
    """Steps of the settling turns."""
    return round(throw.settle_revolutions * 2.0 * pi / (throw.elevator_speed_rad_s * throw.time_step_s))
