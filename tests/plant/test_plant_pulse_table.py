"""Tabulated pulses against the throws they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant.effects import Effects, MoistureDependence
from yieldmon.plant.grain import Grain
from yieldmon.plant.pulse_table import QUANTILES, SEASON, Condition, Detail, PulseTable
from yieldmon.plant.throw import throw

SEED = 20261121
MACHINE = Machine()


def direct(mass, angle, speed, grain=None, effects=None, cells=800):
    return throw(MACHINE, grain or Grain(), effects or Effects(), mass, angle, speed, cells=cells)


def places(count, largest_kg, rpm=(250.0, 600.0)):
    rng = np.random.default_rng(SEED)
    mass = largest_kg * rng.uniform(0.05, 1.0, count) ** 2
    return zip(mass, np.deg2rad(rng.uniform(40.0, 90.0, count)), rng.uniform(*rpm, count) * RPM, strict=True)


@pytest.mark.parametrize(("rpm", "tolerance"), [((300.0, 600.0), 1e-3), ((250.0, 300.0), 2.5e-3)], ids=["usual", "slow"])
def test_impulse_between_the_nodes(default_table, rpm, tolerance):
    # At slow speeds light loads at flat plates land on the very edge, where the impulse has a corner.
    for mass, angle, speed in places(60, 3.5, rpm):
        exact = direct(mass, angle, speed).impulse_n_s.sum()
        assert default_table.impulse_n_s(mass, angle, speed) == pytest.approx(exact, rel=tolerance)


def test_table_with_effects_is_as_close():
    effects = Effects(jet_shielding={}, air_drag={}, residual_radial_speed={})
    table = PulseTable(MACHINE, [Condition(0.0, Grain(), effects)], Detail(shapes=False))
    for mass, angle, speed in places(12, 3.5, (300.0, 600.0)):
        exact = direct(mass, angle, speed, effects=effects).impulse_n_s.sum()
        assert table.impulse_n_s(mass, angle, speed) == pytest.approx(exact, rel=1e-3)


def test_middle_and_width_of_the_pulse(default_table):
    for mass, angle, speed in places(12, 3.0):
        result = direct(mass, angle, speed)
        struck = result.impulse_n_s > 0.0
        time, weight = result.arrival_s[struck], result.impulse_n_s[struck]
        middle = np.average(time, weights=weight)
        width = np.sqrt(np.average((time - middle) ** 2, weights=weight))
        times = default_table.arrival_times_s(mass, angle, speed)
        mids, shares = 0.5 * (times[1:] + times[:-1]), np.diff(QUANTILES)
        assert np.sum(mids * shares) == pytest.approx(middle, abs=2e-4)
        assert np.sqrt(np.sum((mids - middle) ** 2 * shares)) == pytest.approx(width, rel=0.05, abs=2e-4)


def test_changing_crop_between_the_nodes():
    dependence = MoistureDependence()
    grains = {m: Grain().at_moisture(m, dependence) for m in (14.0, 17.0, 20.0, 23.0, 26.0, 18.4)}
    table = PulseTable(MACHINE, [Condition(m, g, Effects()) for m, g in list(grains.items())[:5]], SEASON)
    for mass, angle, speed in places(10, 2.5, rpm=(320.0, 480.0)):
        exact = direct(mass, angle, speed, grain=grains[18.4]).impulse_n_s.sum()
        assert table.impulse_n_s(mass, angle, speed, 18.4) == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize(
    ("mass", "angle_deg", "rpm", "named"),
    [
        (0.5, 70.0, 200.0, "speed_rad_s"),
        (0.5, 20.0, 400.0, "plate_angle_rad"),
        (9.0, 70.0, 400.0, "paddle_mass_kg"),
        (-1e-3, 70.0, 400.0, "paddle_mass_kg"),
    ],
)
def test_outside_the_table_is_refused_by_name(default_table, mass, angle_deg, rpm, named):
    with pytest.raises(ValueError, match=named):
        default_table.impulse_n_s(mass, np.deg2rad(angle_deg), rpm * RPM)


def test_two_conditions_are_refused():
    with pytest.raises(ValueError, match="2 conditions"):
        PulseTable(MACHINE, [Condition(0.0, Grain(), Effects())] * 2)
