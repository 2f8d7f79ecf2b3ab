"""What updates parameters that other machines' loads have made, before and after a load of the machine's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.engine.test_closed_loop_calibrator import MACHINE, MODEL, PRIOR, SPEED, TRUE, records, ticket
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import METHOD, POOLED
from yieldmon.estimation.waveform.common_bias import KernelMeasurement
from yieldmon.physics.model import Conditions

OF_A_FLEET = OpenLoop(MODEL, replace(PRIOR, provenance={METHOD: POOLED}))


@pytest.fixture
def calibrator() -> ClosedLoopCalibrator:
    return ClosedLoopCalibrator(MODEL, CalibratorSettings(closed_loop=ClosedLoopSettings()))


def test_a_sweep_alone_changes_nothing(calibrator: ClosedLoopCalibrator) -> None:
    outcome = calibrator.update(records(12.0), OF_A_FLEET)
    assert outcome.estimator is None
    assert outcome.reason.endswith("sweeps change nothing until a load is weighed")
    plain = ClosedLoopCalibrator(MODEL, CalibratorSettings(closed_loop=ClosedLoopSettings()))
    assert plain.update(records(12.0), OpenLoop(MODEL, PRIOR)).estimator is not None, "the same sweep elsewhere"


def test_after_a_weighed_load_sweeps_do(calibrator: ClosedLoopCalibrator) -> None:
    weighed = calibrator.weigh(records(12.0)[0], (ticket(OF_A_FLEET, 12.0, 0.0, 500.0),), OF_A_FLEET).estimator
    assert weighed is not None
    assert calibrator.update(records(12.0, start_s=700.0), weighed).estimator is not None


def test_kernel_noise_does_not_wait_for_a_load(calibrator: ClosedLoopCalibrator) -> None:
    flow = 10.0 * np.linspace(0.85, 1.15, 12)
    angle, speed = np.full(12, MACHINE.home_plate_angle_rad), np.full(12, SPEED)
    force = np.real(MODEL.force(Conditions(angle, speed, mass_flow_kg_s=flow), TRUE))
    measured = KernelMeasurement(flow, force, angle, speed, np.full(12, np.nan), 0.005, 0.04)
    known = calibrator.update_from_kernels(records(10.0)[0], measured, OF_A_FLEET).estimator
    assert known is not None
    off = [abs(float(np.mean(one.invert(force, angle, speed) / flow)) - 1.0) for one in (OF_A_FLEET, known)]
    assert off[1] < off[0]
