"""What the study of sweeps on machines with a fleet's prior calculates, on one machine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from studies.fleet_prior import sweeps
from studies.fleet_prior.draws import drawn, machine_of
from yieldmon.estimation.parameters import METHOD, POOLED, ParameterSet
from yieldmon.files.crops import crop

SEED = 20261129


@pytest.fixture(scope="module")
def corn() -> ParameterSet:
    known = crop("corn").parameters()
    return replace(known, covariance=known.covariance * 0.1)


@pytest.mark.parametrize("way", sweeps.WAYS)
def test_a_machine_without_anything_hidden_keeps_to_its_loads(way: str, corn: ParameterSet) -> None:
    machine, own = drawn("m", corn.values, np.random.default_rng(SEED), ())
    chance = np.random.default_rng(SEED + 1)
    seen = [sweeps.sweep(own, chance, 1e4 + 2400.0 * count) for count in range(2)]
    known, home_error = sweeps.after(sweeps.WAYS[way], corn, seen, machine.loads[:2])
    error_pct, _ = sweeps.judged(known, home_error, machine.loads[2:])
    assert error_pct < 2.0
    moved = known.values != corn.values
    assert moved is (way != "prior")
    assert (sweeps.ANGLE in known.values) is sweeps.WAYS[way].angle


def test_a_prior_of_the_fleet_is_not_updated_by_sweeps_until_a_load_is_weighed(corn: ParameterSet) -> None:
    pooled = replace(corn, provenance={METHOD: POOLED})
    machine, own = drawn("m", corn.values, np.random.default_rng(SEED))
    chance = np.random.default_rng(SEED + 1)
    seen = [sweeps.sweep(own, chance, 1e4 + 2400.0 * count) for count in range(2)]
    swept, tickets, after = (
        sweeps.after(sweeps.WAYS[way], pooled, seen, machine.loads[:2])[0] for way in ("sweeps", "tickets", "tickets, sweeps")
    )
    assert swept.values == pooled.values
    assert tickets.values != pooled.values
    assert after.values != tickets.values


def test_effects_change_the_forces_and_no_draw(corn: ParameterSet) -> None:
    plain = machine_of("m", corn.values, np.random.default_rng(SEED))
    hidden, _ = drawn("m", corn.values, np.random.default_rng(SEED), effects={"plate_friction.coefficient": 0.15})
    assert [load.weighed_kg for load in hidden.loads] == [load.weighed_kg for load in plain.loads]
    pairs = zip(hidden.loads, plain.loads, strict=True)
    assert all(np.all(np.abs(one.force_n / other.force_n - 1.0) > 0.01) for one, other in pairs)
