"""The model's own error away from the home angle, separated from the grain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.angle_pattern import NAMES, with_pattern, without_pattern
from yieldmon.estimation.self_calibration.closed_loop import self_calibrate
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE = Machine()
HOME, SPEED = MACHINE.home_plate_angle_rad, MACHINE.nominal_elevator_speed_rad_s
PLAIN, PATTERNED = ForwardModel(MACHINE), ForwardModel(MACHINE, ("angle_pattern",))
TRUE = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
KNOWN = ParameterSet(TRUE, ("friction", "restitution", "density"), np.diag([0.02**2, 0.01**2, 10.0**2]))
ANGLES = np.radians([40, 40, 70, 40, 40, 70, 50, 60, 70, 80, 90, 70, 90, 90, 70])


@pytest.mark.parametrize("flow_kg_s", [2.0, 10.0, 20.0])
def test_nothing_changes_at_the_home_angle(flow_kg_s: float) -> None:
    weights = dict.fromkeys(NAMES, 0.05)
    at = Conditions(np.array([HOME, HOME - 0.3]), SPEED, mass_flow_kg_s=flow_kg_s)
    with_one, without = PATTERNED.force(at, TRUE | weights), PLAIN.force(at, TRUE)
    assert with_one[0] == pytest.approx(without[0], rel=1e-12)
    assert abs(with_one[1] / without[1] - 1.0) > 1e-3


@pytest.mark.parametrize(
    ("asked", "model_error", "expected"), [(0.01, 0.0, 0.01), (0.001, 0.0, 0.002), (0.004, 0.0, 0.004), (0.004, 0.01, 0.02)]
)
def test_size_has_a_floor_and_follows_the_calibrations_own_error(asked: float, model_error: float, expected: float) -> None:
    found = with_pattern(replace(KNOWN, model_error=model_error), asked)
    assert [found.standard_deviation(name) for name in NAMES] == pytest.approx([expected] * len(NAMES))


def test_a_pattern_is_added_once_and_taken_away_whole() -> None:
    once = with_pattern(KNOWN, 0.01)
    assert with_pattern(once, 0.5) is once
    back = without_pattern(once)
    assert (back.values, back.covariance_names) == (KNOWN.values, KNOWN.covariance_names)
    np.testing.assert_array_equal(back.covariance, KNOWN.covariance)
    assert without_pattern(KNOWN) is KNOWN


def sweep(friction: float, flow_kg_s: float, error_at_40: float) -> Sweep:
    """A sweep of grain of this friction on a machine whose force at low angles is off by a share."""
    force = np.real(PLAIN.force(Conditions(ANGLES, SPEED, mass_flow_kg_s=flow_kg_s), TRUE | {"friction": friction}))
    force = force * (1.0 + error_at_40 * np.minimum((ANGLES - HOME) / np.radians(-30.0), 1.0).clip(0.0) ** 2)
    return Sweep(2.0 * np.arange(ANGLES.size), ANGLES, np.full(ANGLES.shape, SPEED), force, 0.005 * force)


def friction_after(model: ForwardModel, known: ParameterSet, errors: list[float], frictions: list[float]) -> list[float]:
    settings = ClosedLoopSettings(model_error=0.004, learned_information=1e-6, kept_ratio=1.0 - 1e-6, consistent_p=0.0)
    found = []
    for number, (error, friction) in enumerate(zip(errors, frictions, strict=True)):
        known = self_calibrate(model, known, [sweep(friction, 8.0 + number % 5, error)], settings=settings).parameter_set
        found.append(known.values["friction"])
    return found


@pytest.mark.parametrize("error", [-0.03, 0.03])
def test_what_all_sweeps_share_is_not_taken_for_friction(error: float) -> None:
    without = friction_after(PLAIN, KNOWN, [error] * 6, [0.2] * 6)[-1]
    within = friction_after(PATTERNED, with_pattern(KNOWN, 0.02), [error] * 6, [0.2] * 6)[-1]
    assert abs(within - 0.2) < 0.6 * abs(without - 0.2)


def test_without_an_error_friction_is_still_found() -> None:
    found = friction_after(PATTERNED, with_pattern(KNOWN, 0.004), [0.0] * 4, [0.22] * 4)[-1]
    assert abs(found - 0.22) < 0.5 * 0.02
