"""Tickets of a crop that began with the scale and the curve of another one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.engine.test_closed_loop_calibrator import records
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.self_calibration.load_forces import LoadForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import CARRIED, CARRIED_FROM, SCALE, ParameterSet
from yieldmon.estimation.waveform.common_bias import KernelMeasurement
from yieldmon.files.crops import crop
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE = Machine()
HOME_RAD, SPEED = MACHINE.home_plate_angle_rad, MACHINE.nominal_elevator_speed_rad_s
PUBLISHED = crop("wheat").parameters()
EXPONENT, BEND, SPEED_POWER = "load_pattern.exponent", "load_pattern.bend", "load_pattern.speed"
WEIGHTS = {EXPONENT: -0.12, BEND: 0.0, SPEED_POWER: 0.0}
SDS = {"friction": 0.05, "density": 120.0, "restitution": 0.1, EXPONENT: 0.06, BEND: 0.06, SPEED_POWER: 0.3}
CARRIED_SET = ParameterSet(
    {**PUBLISHED.values, **WEIGHTS, "restitution": 0.1},
    tuple(SDS),
    np.diag(np.square(list(SDS.values()))),
    provenance={**PUBLISHED.provenance, SCALE: CARRIED, CARRIED_FROM: "corn"},
)


def of(known: ParameterSet) -> OpenLoop:
    return OpenLoop(ForwardModel(MACHINE, known.effects), known)


def ticket(number: int, flow_kg_s: float, factor: float = 1.1, known: ParameterSet = CARRIED_SET) -> ReferenceMass:
    """Of a load whose grain strikes stronger by a factor than these parameters say."""
    flow = flow_kg_s * np.linspace(0.85, 1.15, 12)
    at = Conditions(np.full(12, HOME_RAD), np.full(12, SPEED), mass_flow_kg_s=flow)
    force = factor * np.real(ForwardModel(MACHINE, known.effects).force(at, known.values))
    seconds = np.full(12, 50.0)
    kg, start_s = float(seconds @ flow), 1000.0 * number
    forces = LoadForces(seconds, force, np.full(12, HOME_RAD), np.full(12, SPEED), np.full(12, np.nan))
    return ReferenceMass(
        ReferenceSource.TICKET, start_s, start_s + 600.0, kg, 0.004 * kg, kg, True, number, forces=forces
    )  # fmt: skip


def weighed(tickets: list[ReferenceMass], *, restart_after: int = 0) -> ParameterSet:
    """The parameters after these, with a restart after so many of them."""
    settings = CalibratorSettings(steady_per_kilotonne={})
    model = ForwardModel(MACHINE, CARRIED_SET.effects)
    calibrator, estimator = ClosedLoopCalibrator(model, settings), of(CARRIED_SET)
    for count, one in enumerate(tickets, 1):
        now = replace(records(10.0)[0], time_s=one.end_s + 10.0, total_kg=6000.0 * count)
        outcome = calibrator.weigh(now, tickets[:count], estimator)
        assert outcome.estimator is not None, outcome.reason
        estimator = of(outcome.estimator.parameters)
        if count == restart_after:
            state = calibrator.snapshot(now.time_s, now.total_kg)
            assert state is not None
            calibrator = ClosedLoopCalibrator(ForwardModel(MACHINE, estimator.parameters.effects), settings)
            calibrator.restore(state, estimator.parameters, now.total_kg)
            calibrator.remember(tickets[:count], estimator)
    return estimator.parameters


def test_its_first_ticket_sets_the_scale() -> None:
    known = weighed([ticket(1, 10.0)])
    assert (known.is_weighed, known.scale_error, known.carried_from) == (True, 0.0, "")
    assert CARRIED_FROM not in known.provenance
    flow = of(known).estimate(*(ticket(2, 10.0).forces.force_n, HOME_RAD, SPEED)).mass_flow_kg_s  # type: ignore[union-attr]
    assert float(flow.mean()) == pytest.approx(10.0, rel=0.01)


@pytest.mark.parametrize("restart_after", [1, 2])
def test_its_tickets_are_fitted_together_to_what_was_carried_after_a_restart_too(restart_after: int) -> None:
    tickets = [ticket(1, 8.0), ticket(2, 13.0, 1.06), ticket(3, 5.0, 1.13)]
    whole, parted = weighed(tickets), weighed(tickets, restart_after=restart_after)
    assert dict(parted.values) == pytest.approx(dict(whole.values))
    assert parted.covariance == pytest.approx(whole.covariance)


def test_the_order_of_its_tickets_is_of_no_account() -> None:
    """As all of them are fitted to what was known before the first one, none counts twice."""
    tickets = [ticket(1, 8.0), ticket(2, 13.0, 1.06), ticket(3, 5.0, 1.13)]
    there, back = weighed(tickets), weighed([ticket(1, 5.0, 1.13), ticket(2, 13.0, 1.06), ticket(3, 8.0)])
    assert dict(back.values) == pytest.approx(dict(there.values), rel=1e-3)
    assert np.sqrt(np.diag(back.covariance)) == pytest.approx(np.sqrt(np.diag(there.covariance)), rel=0.01)


def test_its_first_ticket_is_fitted_as_the_first_of_a_machine() -> None:
    """Also where a force that rises steeply makes the flow known to less than 10 %."""
    steep = replace(CARRIED_SET, values={**CARRIED_SET.values, EXPONENT: 0.8})
    narrow = replace(steep, covariance=0.01 * steep.covariance)
    calibrator = ClosedLoopCalibrator(ForwardModel(MACHINE, narrow.effects), CalibratorSettings())
    estimate = of(narrow).estimate(60.0, HOME_RAD, SPEED)
    assert float(estimate.std_dev_kg_s / estimate.mass_flow_kg_s) < 0.1
    said = calibrator.weigh(records(10.0)[0], [ticket(1, 7.0, 1.05, narrow)], of(narrow)).reason
    assert "by one ticket alone" in said


def test_kernel_noise_sets_its_scale_too() -> None:
    calibrator = ClosedLoopCalibrator(ForwardModel(MACHINE, CARRIED_SET.effects), CalibratorSettings())
    forces = ticket(1, 10.0).forces
    assert forces is not None
    columns = forces.plate_angle_rad, forces.elevator_speed_rad_s, forces.moisture_pct
    measured = KernelMeasurement(10.0 * np.linspace(0.85, 1.15, 12), forces.force_n, *columns, 0.005, 0.04)
    known = calibrator.update_from_kernels(records(10.0)[0], measured, of(CARRIED_SET)).estimator
    assert known is not None
    assert (known.parameters.scale_error, known.parameters.carried_from) == (0.0, "")
    assert CARRIED_FROM not in known.parameters.provenance
