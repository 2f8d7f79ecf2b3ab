"""The update by a ticket depends on the zero of its load, on grain of another moisture than before, and on the model's error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.engine.test_closed_loop_calibrator import MACHINE, MODEL, PRIOR, SPEED, records
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.self_calibration.load_forces import LoadForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import NOT_CALIBRATED, SCALE, ParameterSet
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, NODES_RAD, AngleError
from yieldmon.physics.model import Conditions

FLOW_KG_S, SECONDS = 10.0, 500.0
SURE = replace(PRIOR, covariance=PRIOR.covariance / 100.0)
"""The force at home is good to some 0.8 %."""


def ticket(weaker: float, budget: MassBudget, moisture_pct: float = 18.0) -> ReferenceMass:
    """Of a load whose grain strikes weaker by a share than the parameters say."""
    home = MACHINE.home_plate_angle_rad
    force = (1.0 - weaker) * np.real(MODEL.force(Conditions(home, SPEED, mass_flow_kg_s=FLOW_KG_S), SURE.values))
    measured = SECONDS * float(OpenLoop(MODEL, SURE).invert(force, home, SPEED))
    columns = (np.full(10, value) for value in (SECONDS / 10.0, force, home, SPEED, moisture_pct))
    mass = FLOW_KG_S * SECONDS
    return ReferenceMass(
        ReferenceSource.TICKET, 0.0, SECONDS, mass, 0.005 * mass, measured, True, 1, budget, forces=LoadForces(*columns)
    )


def learnt(reference: ReferenceMass, error: AngleError = NO_ERROR) -> ParameterSet:
    """The parameters after it, where loads were stated with this error of the model."""
    settings = CalibratorSettings(steady_per_kilotonne={})
    outcome = ClosedLoopCalibrator(MODEL, settings).weigh(records(FLOW_KG_S)[0], (reference,), OpenLoop(MODEL, SURE), error)
    assert outcome.estimator is not None
    return outcome.estimator.parameters


def left(reference: ReferenceMass, error: AngleError = NO_ERROR) -> tuple[float, float]:
    """Error with which the ticket's own load is measured after it, and its standard deviation, as shares."""
    assert reference.forces is not None
    found = OpenLoop(MODEL, learnt(reference, error)).estimate(
        reference.forces.force_n, reference.forces.plate_angle_rad, reference.forces.elevator_speed_rad_s
    )
    rate = float(np.mean(found.mass_flow_kg_s))
    return rate / FLOW_KG_S - 1.0, float(np.mean(found.std_dev_kg_s)) / rate


def test_a_ticket_sets_the_scale_for_the_moisture_of_its_grain() -> None:
    """Of 2 % by a point of moisture little is to be drawn towards what held for other grain; it was 1.4 % with 0.5 % stated."""
    same, other = (left(ticket(0.02, MassBudget(moisture_kg=share * FLOW_KG_S * SECONDS))) for share in (0.0, 0.02))
    assert same[0] < -0.01
    assert abs(other[0]) < min(0.3 * abs(same[0]), 0.5 * other[1])


def test_moisture_that_was_not_measured_leaves_the_tickets_to_average() -> None:
    budget = MassBudget(moisture_kg=0.04 * FLOW_KG_S * SECONDS)
    assert left(ticket(0.02, budget, float("nan"))) == pytest.approx(left(ticket(0.02, MassBudget())))


def test_a_ticket_is_no_surer_than_the_zero_of_its_load() -> None:
    known, unsure = (left(ticket(0.005, MassBudget(zero_kg=share * FLOW_KG_S * SECONDS))) for share in (0.0, 0.01))
    assert unsure[1] > 1.15 * known[1]
    assert unsure[0] < known[0] < 0.0


HOME_RAD = MACHINE.home_plate_angle_rad


def one_cause(at_home: float, away: float) -> AngleError:
    """That changes the force by so much at home, and at 40 deg."""
    change = np.interp(NODES_RAD, [np.radians(40.0), HOME_RAD], [away, at_home])
    return AngleError.of(np.outer(change, change), HOME_RAD)


@pytest.mark.parametrize("weaker", [0.015, 0.04])
def test_a_ticket_sets_a_scale_that_the_models_error_has_left_open(weaker: float) -> None:
    """A load that is stated with 5 % is not drawn back to parameters that the ticket finds off by less."""
    found = left(ticket(weaker, MassBudget()), one_cause(0.05, 0.05))
    assert abs(found[0]) < 0.1 * weaker
    assert abs(found[0]) < found[1] < 0.01


def test_a_load_away_from_home_says_less_of_the_scale_there() -> None:
    whole = ticket(0.04, MassBudget())
    assert whole.forces is not None
    angle = np.where(np.arange(10) < 5, HOME_RAD, np.radians(40.0))
    force = np.real(MODEL.force(Conditions(angle, SPEED, mass_flow_kg_s=FLOW_KG_S), SURE.values))
    half = replace(whole, forces=replace(whole.forces, force_n=0.96 * force, plate_angle_rad=angle))

    def sd(reference: ReferenceMass, error: AngleError) -> float:
        known = OpenLoop(MODEL, learnt(reference, error)).estimate(*(whole.forces.force_n, HOME_RAD, SPEED))  # type: ignore[union-attr]
        return float(np.mean(known.std_dev_kg_s / known.mass_flow_kg_s))

    same, other = one_cause(0.05, 0.05), one_cause(0.05, 0.15)
    assert sd(whole, other) == pytest.approx(sd(whole, same), rel=1e-6)
    assert sd(half, other) > 3.0 * sd(half, same)


def test_parameters_say_that_a_weighed_mass_has_set_their_scale() -> None:
    assert not SURE.is_weighed
    assert learnt(ticket(0.04, MassBudget())).is_weighed


def test_a_clock_set_back_in_a_load_leaves_its_ticket_a_reference() -> None:
    """A computer without a clock of its own begins with a time that is months ahead, until its first fix."""
    weighed = ticket(0.02, MassBudget())
    set_back = replace(weighed, start_s=weighed.start_s + 5e6)
    assert left(set_back) == pytest.approx(left(weighed))


@pytest.mark.parametrize(("changes", "comparable"), [
    ({}, True),
    ({"start_s": 600.0}, True),
    ({"forces": None}, True),
    ({"forces": None, "start_s": 600.0}, False),
    ({"complete": False}, False),
    ({"measured_kg": 0.0}, False),
])  # fmt: skip
def test_a_mass_is_comparable_by_its_forces_or_its_time(changes: dict[str, object], comparable: bool) -> None:
    assert replace(ticket(0.0, MassBudget()), **changes).comparable is comparable


@pytest.mark.parametrize("weaker", [0.01, 0.35])
def test_the_first_ticket_ends_what_a_machine_without_calibration_states(weaker: float) -> None:
    """Also one that agrees: at its own flow the load is known then, and at others only as far as one load tells of the curve."""
    bare = replace(SURE, provenance={SCALE: NOT_CALIBRATED})

    def stated(known: ParameterSet, flow_kg_s: float) -> float:
        force = np.real(MODEL.force(Conditions(HOME_RAD, SPEED, mass_flow_kg_s=flow_kg_s), SURE.values))
        found = OpenLoop(MODEL, known).estimate((1.0 - weaker) * force, HOME_RAD, SPEED)
        return float(found.std_dev_kg_s / found.mass_flow_kg_s)

    settings = CalibratorSettings(steady_per_kilotonne={})
    anchor = ticket(weaker, MassBudget())
    outcome = ClosedLoopCalibrator(MODEL, settings).weigh(records(FLOW_KG_S)[0], (anchor,), OpenLoop(MODEL, bare))
    assert outcome.estimator is not None
    known = outcome.estimator.parameters
    assert known.is_weighed
    assert stated(bare, FLOW_KG_S) > 0.3
    assert stated(known, FLOW_KG_S) < 0.02
    assert stated(known, 0.5 * FLOW_KG_S) > 0.03
    assert [check.p_value > 0.05 for check in outcome.checks] == [True], "what is known to 45 % contradicts no ticket"
