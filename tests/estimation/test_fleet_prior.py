"""A crop's prior from many machines' loads: what the fleet shares is found, what differs stays in the deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.weighing.density_and_gain import moved
from yieldmon.estimation.weighing.fleet_prior import MachineLoads, load_errors, pooled
from yieldmon.estimation.weighing.load_departures import spread
from yieldmon.estimation.weighing.load_inputs import LoadSettings, WeighedLoad
from yieldmon.files.crops import crop
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

SHIPPED = crop("corn").parameters()
MODEL = ForwardModel(Machine(), SHIPPED.effects)


def fleet(count: int, gain_sd: float, density: float, seed: int) -> list[MachineLoads]:
    """Machines whose sensors differ in gain, in a crop whose density is `density` times the shipped one."""
    chance = np.random.default_rng(seed)
    values = dict(SHIPPED.values) | {"density": density * SHIPPED.values["density"]}
    angle, speed = MODEL.machine.home_plate_angle_rad, MODEL.machine.nominal_elevator_speed_rad_s
    machines = []
    for number in range(count):
        gain = float(np.exp(chance.normal(0.0, gain_sd)))
        loads = []
        for load, rate in enumerate((6.0, 8.0, 10.0)):
            flow = np.full(6, rate)
            force = np.real(MODEL.force(Conditions(np.full(6, angle), np.full(6, speed), mass_flow_kg_s=flow), values)) * gain
            weighed = float(np.sum(flow)) * 100.0 * float(np.exp(chance.normal(0.0, 0.003)))
            loads.append(
                WeighedLoad(str(load), weighed, 0.003 * weighed, np.full(6, 100.0), force, np.full(6, angle), np.full(6, speed))
            )
        machines.append(MachineLoads(f"m{number}", MODEL, tuple(loads)))
    return machines


def std_devs(known: ParameterSet, loads: Sequence[WeighedLoad]) -> Array:
    """Relative standard deviation of each load by the parameters alone, (n,)."""
    return np.array([spread(MODEL, known, load, LoadSettings(load_error=0.0)) for load in loads])


def test_what_all_share_is_taken_off_the_next_machines_error() -> None:
    machines = fleet(8, 0.01, 1.2, 3)
    found = pooled(SHIPPED, machines[:7])
    before = np.abs(load_errors(MODEL, SHIPPED, machines[7].loads))
    after = load_errors(MODEL, found.parameter_set, machines[7].loads)
    assert np.mean(np.abs(after)) <= 0.5 * np.mean(before)
    assert np.all(np.abs(after) < 3.0 * std_devs(found.parameter_set, machines[7].loads))


def test_machines_that_differ_more_leave_more_to_be_expected() -> None:
    alike, different = (pooled(SHIPPED, fleet(8, sd, 1.0, 5)) for sd in (0.005, 0.08))
    loads = fleet(1, 0.0, 1.0, 1)[0].loads
    narrow, wide = (std_devs(found.parameter_set, loads).mean() for found in (alike, different))
    assert wide > 1.5 * narrow
    assert np.trace(different.between) > np.trace(alike.between)


def test_one_machine_more_makes_the_crop_better_known() -> None:
    machines = fleet(9, 0.02, 1.1, 8)
    few, many = (pooled(SHIPPED, machines[:count]) for count in (3, 9))
    assert np.trace(many.of_crop) < np.trace(few.of_crop)


@pytest.mark.parametrize(("own_loads", "most"), [(1, 0.005), (0, 0.02)])
def test_another_monitors_error_is_one_in_all_trucks_that_it_filled_too(own_loads: int, most: float) -> None:
    """Ten such trucks say no more of the scale than one: whether it reads 5 % too much or too little changes little."""
    machines = fleet(6, 0.01, 1.1, 3)
    own, shared = machines[0].loads[:own_loads], machines[0].loads[1:] * 5

    def found(bias: float) -> tuple[Array, Array]:
        """Errors of the machine's loads by its own parameters and by the prior."""
        off = [replace(load, weighed_kg=load.weighed_kg * np.exp(bias)) for load in shared]
        off = [replace(load, common_kg=0.05 * load.weighed_kg, std_dev_kg=0.0501 * load.weighed_kg) for load in off]
        pool = pooled(SHIPPED, [MachineLoads("m0", MODEL, (*own, *off)), *machines[1:]])
        sets = moved(SHIPPED, *pool.machines[0]), pool.parameter_set
        return tuple(load_errors(MODEL, known, machines[0].loads) for known in sets)  # type: ignore[return-value]

    (own_low, prior_low), (own_high, prior_high) = found(-0.05), found(0.05)
    assert np.abs(own_high - own_low).max() < most
    assert np.abs(prior_high - prior_low).max() < 0.003


def test_two_machines_are_no_fleet() -> None:
    with pytest.raises(ValueError, match="2 machines"):
        pooled(SHIPPED, fleet(2, 0.01, 1.0, 1))


def test_density_and_gain_follow_a_friction_that_is_found_later() -> None:
    machines = fleet(6, 0.005, 1.1, 4)
    prior = pooled(SHIPPED, machines[:5]).parameter_set
    names = ("friction", "density", "restitution")
    covariance = prior.covariance_of(names)
    more = prior.standard_deviation("friction")

    def measured(*steps: float) -> float:
        values = dict(prior.values) | {name: prior.values[name] + step for name, step in zip(names, steps, strict=True)}
        return float(load_errors(MODEL, replace(prior, values=values), machines[5].loads).mean())

    before, alone = measured(0.0, 0.0, 0.0), measured(more, 0.0, 0.0)
    together = measured(*covariance[0] / more)
    assert abs(together - before) < 0.2 * abs(alone - before)
