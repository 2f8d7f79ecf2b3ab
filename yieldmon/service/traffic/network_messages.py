"""What leaves on the network, from the engine's terms: faults as DM1 carries them, seconds as a task controller gets them."""

from __future__ import annotations

from collections.abc import Iterable

import can

from yieldmon.engine.faults import FAULTS, FaultCode, Severity
from yieldmon.engine.mass.totals import Totals, dry_mass
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.settings import TotalsSettings
from yieldmon.finite import finite
from yieldmon.frames import OperatingState
from yieldmon.network.diagnostics import Lamp, TroubleCode
from yieldmon.network.identifier import RawFrame
from yieldmon.network.task_controller.combine import Second

_LAMPS = {Severity.NOTE: None, Severity.WARNING: Lamp.AMBER_WARNING, Severity.STOP_TRUSTING: Lamp.AMBER_WARNING}


def trouble_code(code: FaultCode) -> TroubleCode:
    """A fault as DM1 carries it."""
    definition = FAULTS[code]
    return TroubleCode(definition.spn, definition.fmi, _LAMPS[definition.severity])


def second_of(record: WindowRecord, totals: Totals, settings: TotalsSettings) -> Second:
    """A record as a task controller gets it; dry figures where the moisture is known."""
    flow = finite(record.mass_flow_kg_s)
    return Second(
        flow_kg_s=flow,
        total_kg=record.total_kg,
        harvesting=record.operating_state in (OperatingState.HARVESTING, OperatingState.SWEEPING),
        dry_flow_kg_s=None if flow is None else dry_mass(flow, record.moisture_pct, settings, totals.market_moisture_pct),
        dry_total_kg=totals.known_total_dry_kg,
        moisture_pct=finite(record.moisture_pct),
        ground_speed_m_s=finite(record.ground_speed_m_s),
        first_load=totals.first_load,
    )


def messages(frames: Iterable[RawFrame]) -> list[can.Message]:
    """The node's frames as python-can sends them."""
    return [can.Message(arbitration_id=f.identifier, data=f.data, is_extended_id=True) for f in frames]
