"""Machines of a fleet that are alike but for noise: what is stated of the noise explains what they show."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.discrepancy.fleet import examine
from yieldmon.discrepancy.force_change import Visible
from yieldmon.discrepancy.lattice import Lattice, lay
from yieldmon.discrepancy.policy import Policy
from yieldmon.estimation.home_flow import AwayVisits
from yieldmon.files import parameter_file
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE, SHIPPED = Machine(), parameter_file.load()
MODEL = ForwardModel(MACHINE, SHIPPED.effects)
ANGLE = np.radians([40.0, 40.0, 40.0, 50.0, 60.0, 80.0, 90.0, 90.0, 90.0])
HOME = np.full(ANGLE.size, MACHINE.home_plate_angle_rad)
FORCE_VARIANCE, FLOW_VARIANCE = 1e-4, 3e-4
SEARCH_NOTHING = Policy(most_effects=0)


def alike(correlation: float, rng: np.random.Generator, machines: int = 5, sweeps: int = 24, offset_rad: float = 0.0) -> Lattice:
    """Machines that are the model's own but for noise, of which visits of one sweep share a part of that in their flow.

    offset_rad: by how much the plate of the first is turned from what it says.
    """
    shared = FLOW_VARIANCE * (correlation + (1.0 - correlation) * np.eye(ANGLE.size))
    made = []
    for number in range(machines):
        of_machine = []
        for sweep in range(sweeps):
            speed, flow = np.full(ANGLE.size, (380.0, 420.0)[sweep % 2] * RPM), np.full(ANGLE.size, rng.uniform(5.0, 14.0))
            turned = offset_rad * (number == 0)
            at = [Conditions(a, speed, mass_flow_kg_s=flow, moisture_pct=15.0) for a in (ANGLE + turned, HOME + turned, HOME)]
            away, home, known = (np.real(MODEL.force(where, SHIPPED.values)) for where in at)
            # Flow is what the force at home says; the gain is brought to one by tickets.
            force = away * known / home
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


@pytest.fixture(scope="module")
def visible_offset() -> Visible:
    """From what angle a turned plate shows."""
    found = examine(alike(0.0, np.random.default_rng(7), sweeps=12), np.random.default_rng(1), SEARCH_NOTHING)
    (offset,) = [v for v in found.visible_from if v.effect == "plate_angle_offset"]
    assert (offset.parameter, offset.unit) == ("angle_rad", "rad")
    assert 0.0 < offset.size < 0.1
    return offset


@pytest.mark.parametrize(("times", "deviating"), [(2.0, ("m0",)), (0.3, ())])
def test_an_effect_shows_from_the_size_that_is_stated(visible_offset: Visible, times: float, deviating: tuple[str, ...]) -> None:
    bent = alike(0.0, np.random.default_rng(7), sweeps=12, offset_rad=times * visible_offset.size)
    assert examine(bent, np.random.default_rng(1), SEARCH_NOTHING).deviating == deviating
