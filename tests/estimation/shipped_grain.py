"""The default machine and grain parameters close to the shipped corn's, with a covariance, for tests of weighed loads."""

from __future__ import annotations

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel

MACHINE = Machine()
MODEL = ForwardModel(MACHINE)
SHIPPED = ParameterSet(
    {"friction": 0.19, "density": 1075.0, "shape_ratio": 2.0, "restitution": 0.55},
    ("friction", "density", "restitution"),
    np.diag([0.004**2, 10.0**2, 0.001**2]),
)
