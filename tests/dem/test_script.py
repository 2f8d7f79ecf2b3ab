"""What the engine is told."""

from __future__ import annotations

import re
from dataclasses import replace
from math import degrees, pi, radians

import pytest

from yieldmon.plant.dem import script
from yieldmon.plant.dem.job import Contact, Grain, Throw, Walls

THROW = Throw(paddle_mass_kg=0.5)


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


def test_heaps_are_handed_over_well_before_the_edge() -> None:
    assert degrees(THROW.release.angle_rad - script.start_angle_rad(THROW)) == pytest.approx(108.0)
