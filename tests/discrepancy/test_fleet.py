"""Machines of a fleet that are alike but for noise: what is stated of the noise explains what they show."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.discrepancy.fleet import examine
from yieldmon.discrepancy.lattice import Lattice, lay
from yieldmon.discrepancy.selection import Policy
from yieldmon.estimation.home_flow import AwayVisits
from yieldmon.files import parameter_file
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE, SHIPPED = Machine(), parameter_file.load()
MODEL = ForwardModel(MACHINE, SHIPPED.effects)
ANGLE = np.radians([40.0, 40.0, 40.0, 50.0, 60.0, 80.0, 90.0, 90.0, 90.0])
FORCE_VARIANCE, FLOW_VARIANCE = 1e-4, 3e-4
SEARCH_NOTHING = Policy(most_effects=0)


def alike(correlation: float, rng: np.random.Generator, machines: int = 5, sweeps: int = 24) -> Lattice:
    """Machines that are the model's own but for noise, of which visits of one sweep share a part of that in their flow."""
    shared = FLOW_VARIANCE * (correlation + (1.0 - correlation) * np.eye(ANGLE.size))
    made = []
    for number in range(machines):
        of_machine = []
        for sweep in range(sweeps):
            speed, flow = np.full(ANGLE.size, (380.0, 420.0)[sweep % 2] * RPM), np.full(ANGLE.size, rng.uniform(5.0, 14.0))
            force = np.real(MODEL.force(Conditions(ANGLE, speed, mass_flow_kg_s=flow, moisture_pct=15.0), SHIPPED.values))
            read = force * np.exp(np.sqrt(FORCE_VARIANCE) * rng.standard_normal(ANGLE.size))
            taken = flow * np.exp(rng.multivariate_normal(np.zeros(ANGLE.size), shared))
            of_machine.append(AwayVisits(ANGLE, speed, taken, read, 15.0, np.full(ANGLE.size, FORCE_VARIANCE), shared))
        made.append((f"m{number}", of_machine))
    return lay(MACHINE, SHIPPED, 10.0, made)


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_noise_that_visits_of_a_sweep_share_is_no_gap_of_the_model(correlation: float) -> None:
    found = examine(alike(correlation, np.random.default_rng(7)), np.random.default_rng(1), SEARCH_NOTHING)
    assert found.deviating == ()
    assert found.misfit == pytest.approx(1.0, abs=0.15)
    assert found.shared.base_gap.f == pytest.approx(1.0, abs=0.3)
    assert found.shared.base_gap.p_value > 0.01
