from __future__ import annotations

import pytest

from yieldmon.physics.machine import Machine
from yieldmon.plant.combine import pulse_table
from yieldmon.plant.pulse_table import PulseTable
from yieldmon.plant.scenario import Scenario


@pytest.fixture(scope="session")
def default_table() -> PulseTable:
    """Pulses of the default crop, shared because building them takes a second."""
    return pulse_table(Scenario(), Machine())
