"""Cost of the published calibration with 100 starts and of reading one sweep (`tools/bench`)."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.fitting.calibration import calibrate
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop import self_calibrate
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MODEL = ForwardModel(Machine())
GRAIN = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
NAMES = ("friction", "restitution", "density")
SPEED_RAD_S = 400.0 * RPM


@pytest.mark.benchmark(group="published calibration, 8 flows at 70 deg")
@pytest.mark.parametrize("starts", [20, 100])
def test_calibration(benchmark, starts):
    conditions = Conditions(np.radians(70.0), SPEED_RAD_S, mass_flow_kg_s=np.array([2.0, 5.0, 9.0, 12.0, 15.0, 18.0, 21.0, 25.0]))
    rows = Measurements(conditions, np.real(MODEL.paddle_momentum(conditions, GRAIN)))
    start = dict(GRAIN, friction=0.5, density=1500.0)
    result = benchmark(lambda: calibrate(MODEL, rows, start, NAMES, starts=starts, rng=np.random.default_rng(0)))
    assert result.parameter_set.values["density"] == pytest.approx(1100.0, rel=1e-6)


@pytest.mark.benchmark(group="one closed-loop sweep, 33 windows")
@pytest.mark.parametrize("flow", ["constant", "process"])
def test_sweep(benchmark, flow):
    angles = np.radians(np.concatenate([[a, a, 70.0] for a in np.arange(40.0, 91.0, 5.0)]))
    force = np.real(MODEL.force(Conditions(angles, SPEED_RAD_S, mass_flow_kg_s=12.0), dict(GRAIN, friction=0.24)))
    rng = np.random.default_rng(0)
    sweep = Sweep(2.0 * np.arange(33), angles, np.full(33, SPEED_RAD_S), force * (1.0 + 0.02 * rng.normal(size=33)), 0.02 * force)
    prior = ParameterSet(GRAIN, NAMES, np.diag([0.04**2, 0.06**2, 110.0**2]))
    settings = ClosedLoopSettings(flow=flow, model_error=0.01 if flow == "process" else 0.0)
    outcome = benchmark(lambda: self_calibrate(MODEL, prior, [sweep], settings=settings))
    assert outcome.consistent
