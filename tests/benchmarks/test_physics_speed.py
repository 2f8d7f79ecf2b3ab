"""Cost of the forward model and of one inversion, beside the published algorithm in the same run (`tools/bench`)."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

from .stepwise_model import Case, mass_flow, paddle_momentum

PARAMETERS = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.6}
ANGLES_RAD = np.radians(np.arange(40.0, 91.0, 5.0))
FLOWS_KG_S = np.array([2.0, 5.0, 9.0, 12.0, 15.0, 18.0, 21.0, 25.0])
SPEED_RAD_S = 400.0 * RPM
HOME_RAD = np.radians(70.0)


@pytest.mark.benchmark(group="table 11.2 (88 forward values)")
def test_table_ours(benchmark):
    model = ForwardModel(Machine())
    conditions = Conditions(ANGLES_RAD, SPEED_RAD_S, mass_flow_kg_s=FLOWS_KG_S[:, None])
    assert benchmark(lambda: model.paddle_momentum(conditions, PARAMETERS)).shape == (8, 11)


@pytest.mark.benchmark(group="table 11.2 (88 forward values)")
def test_table_published_algorithm(benchmark):
    case = Case()
    rows = benchmark(lambda: [[paddle_momentum(case, f, a) for a in ANGLES_RAD] for f in FLOWS_KG_S])
    ours = ForwardModel(Machine()).paddle_momentum(
        Conditions(ANGLES_RAD, SPEED_RAD_S, mass_flow_kg_s=FLOWS_KG_S[:, None]), PARAMETERS
    )
    # Its step sum is good to 0.41 % at 200 layers.
    np.testing.assert_allclose(rows, ours, rtol=5e-3)


@pytest.mark.benchmark(group="one open-loop inversion")
def test_inversion_ours(benchmark):
    model = ForwardModel(Machine())
    force = float(model.force(Conditions(HOME_RAD, SPEED_RAD_S, mass_flow_kg_s=12.0), PARAMETERS))
    loop = OpenLoop(model, ParameterSet(PARAMETERS))
    assert float(benchmark(lambda: loop.invert(force, HOME_RAD, SPEED_RAD_S))) == pytest.approx(12.0, rel=1e-9)


@pytest.mark.benchmark(group="one open-loop inversion")
def test_inversion_published_algorithm(benchmark):
    model = ForwardModel(Machine())
    force = float(model.force(Conditions(HOME_RAD, SPEED_RAD_S, mass_flow_kg_s=12.0), PARAMETERS))
    flow = benchmark(lambda: mass_flow(Case(), force, float(HOME_RAD)))
    assert flow == pytest.approx(12.0, rel=5e-3)
