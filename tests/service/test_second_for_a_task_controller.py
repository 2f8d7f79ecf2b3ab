"""A second as a task controller gets it: what is harvest, what is not known."""

from __future__ import annotations

from dataclasses import replace
from math import nan

import pytest

from tests.engine.test_closed_loop_calibrator import records
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.settings import TotalsSettings
from yieldmon.frames import OperatingState
from yieldmon.service.traffic.network_messages import second_of

RECORD = replace(records(10.0, moisture=20.0)[0], total_kg=500.0, ground_speed_m_s=1.5)
SETTINGS = TotalsSettings(moisture_reference_pct=None)
TOTALS = Totals(total_kg=500.0, total_dry_kg=400.0, market_moisture_pct=15.0)


@pytest.mark.parametrize("state", list(OperatingState))
def test_it_is_harvest_while_grain_is_measured_at_home_or_in_a_sweep(state: OperatingState) -> None:
    harvesting = second_of(replace(RECORD, operating_state=state), TOTALS, SETTINGS).harvesting
    assert harvesting is (state.name in ("HARVESTING", "SWEEPING"))


def test_wet_and_dry_figures() -> None:
    """Ten kilograms with 20 % of water are 8 kg of dry matter, which weigh 8 / 0.85 kg at 15 %."""
    found = second_of(RECORD, TOTALS, SETTINGS)
    assert (found.flow_kg_s, found.total_kg, found.moisture_pct, found.ground_speed_m_s) == (10.0, 500.0, 20.0, 1.5)
    assert found.dry_flow_kg_s == pytest.approx(8.0 / 0.85)
    assert found.dry_total_kg == 400.0


def test_what_is_not_known_is_none() -> None:
    dry = second_of(replace(RECORD, moisture_pct=nan), replace(TOTALS, total_unknown_moisture_kg=3.0), SETTINGS)
    assert (dry.flow_kg_s, dry.moisture_pct, dry.dry_flow_kg_s, dry.dry_total_kg) == (10.0, None, None, None)
    still = second_of(replace(RECORD, mass_flow_kg_s=nan, ground_speed_m_s=nan), TOTALS, SETTINGS)
    assert (still.flow_kg_s, still.dry_flow_kg_s, still.ground_speed_m_s, still.total_kg) == (None, None, None, 500.0)
