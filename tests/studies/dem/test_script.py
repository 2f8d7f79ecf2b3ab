"""The engine's input script."""

from __future__ import annotations

import re
from dataclasses import replace
from math import degrees, pi, radians
from pathlib import Path

import numpy as np
import pytest

from studies.dem import script
from studies.dem.job import Contact, Grain, Throw, Walls, kernel_defaults, merged, throw_from_dict

THROW = Throw(paddle_mass_kg=0.5)
CLUMPS = throw_from_dict(merged(kernel_defaults("clump"), {"paddle_mass_kg": 0.5}))


def test_wall_modulus_gives_the_modulus_of_grain_on_wall() -> None:
    rigid = replace(THROW, walls=Walls(shear_modulus_pa=1e20))
    assert script.wall_modulus_pa(rigid) == pytest.approx(2.0 * rigid.grain.youngs_modulus_pa, rel=1e-9)
    alike = replace(THROW, walls=Walls(shear_modulus_pa=Grain().shear_modulus_pa, poisson=Grain().poisson))
    assert script.wall_modulus_pa(alike) == pytest.approx(alike.grain.youngs_modulus_pa, rel=1e-12)


def test_contact_words_carry_the_coefficients() -> None:
    words = script.contact_model(replace(THROW, contact=Contact(0.21, 0.07, 0.66)), 1e7)
    assert words.startswith("hertz/material 10000000.0 0.66 0.4 tangential mindlin_rescale NULL 1.0 0.21 ")
    assert "rolling sds 1000.0 0.2 0.07" in words
    assert words.endswith("damping coeff_restitution")


@pytest.mark.parametrize("angle_deg", [40.0, 70.0, 90.0])
def test_plate_turns_about_its_top_edge(angle_deg: float) -> None:
    variable, region, fix = script.plate_wall(THROW, radians(angle_deg))
    assert float(variable.split()[-1]) == pytest.approx(radians(angle_deg))
    x0, x1, y0, y1 = (float(v) for v in region.split()[3:7])
    m = THROW.machine
    assert (x0, y1) == (m.plate_pivot_x_m, m.plate_pivot_y_m)
    assert x1 - x0 == pytest.approx(m.plate_length_m)
    assert y1 - y0 == pytest.approx(script.PLATE_THICKNESS_M)
    assert f"rotate v_plate_angle {x0!r} {y1!r} 0 0 0 1" in region
    assert script.STRIKING in fix


def test_settling_ends_with_the_paddle_at_the_start_angle() -> None:
    steps = script.settle_steps(THROW)
    turned = steps * THROW.elevator_speed_rad_s * THROW.time_step_s
    assert turned == pytest.approx(2.0 * pi * THROW.settle_revolutions, rel=1e-3)
    first = script.start_angle_rad(THROW) - turned
    variable = script.machine_walls(THROW, first)[0]
    match = re.fullmatch(r"variable paddle_angle equal (\S+)\+(\S+)\*step", variable)
    assert match is not None
    assert float(match[1]) + float(match[2]) * steps == pytest.approx(radians(162.0))


def test_clumps_move_as_bodies_whose_spheres_do_not_meet() -> None:
    assert "atom_style sphere" in script.world(THROW)
    assert any(line.startswith("fix move all nve/sphere") for line in script.motion(THROW))
    assert not any("exclude" in line for line in script.world(THROW))
    assert any(line.endswith("exclude molecule/intra all") for line in script.neighbours(CLUMPS))
    assert not any("nve/sphere" in line for line in script.motion(CLUMPS))
    assert script.bodies(Path("heap.rigid")) == ["fix move all rigid/small molecule infile heap.rigid"]


def test_clumps_are_dropped_before_they_reach_the_limits() -> None:
    """Within the steps between two looks a clump goes less far than the margin less its own size, at twice the tip speed."""
    region = next(line for line in script.motion(CLUMPS) if line.startswith("region beyond block"))
    inner = [float(v) for v in region.split()[3:9]]
    assert inner == pytest.approx([v for low, high in script.BOX_M for v in (low + script.LEAVING_M, high - script.LEAVING_M)])
    way_m = 2.0 * CLUMPS.elevator_speed_rad_s * CLUMPS.machine.paddle_length_m * script.LEAVING_STEPS * CLUMPS.time_step_s
    assert way_m + 2.0 * CLUMPS.grain.reach_m < script.LEAVING_M


def test_a_bodys_line() -> None:
    inertia = np.array([[[1.0, 4.0, 5.0], [4.0, 2.0, 6.0], [5.0, 6.0, 3.0]]])
    text = script.body_lines(
        np.array([0.1]), np.array([[7.0, 8.0, 9.0]]), np.array([[-1.0, -2.0, -3.0]]), inertia, np.array([[0.01, 0.02, 0.03]])
    )
    count, line = text.splitlines()
    assert count == "1"
    expected = [1, 0.1, 7, 8, 9, 1, 2, 3, 4, 5, 6, -1, -2, -3, 0.01, 0.02, 0.03, 0, 0, 0]
    assert [float(word) for word in line.split()] == expected


def test_heaps_are_handed_over_well_before_the_edge() -> None:
    assert degrees(THROW.release.angle_rad - script.start_angle_rad(THROW)) == pytest.approx(108.0)
