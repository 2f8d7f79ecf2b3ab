"""The device description of a combine with this monitor, and the raw values of its variables."""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon import data_dictionary as ddi
from yieldmon.network.name import Name
from yieldmon.network.process_data import MOST
from yieldmon.physics.machine import Implement

from .pool import Device, Element, ElementType, Presentation, Property, Trigger, Variable

YIELD_ELEMENT = 2
"""Number of the element that carries flow, yield and totals."""
DEFAULTS_DDI = 57343
"""Request for default process data, on the device element."""

OWN_TOTALS = (ddi.TOTAL_MASS, ddi.DRY_TOTAL)
"""Those that the monitor counts; the client counts the others."""
TOTALS = (*OWN_TOTALS, ddi.TOTAL_AREA, ddi.EFFECTIVE_TIME)

_TONNES_PER_HECTARE = Presentation("t/ha", 1e-5, 2)
_KG_PER_S = Presentation("kg/s", 1e-6, 2)
_KG = Presentation("kg", 1.0, 0)
_PERCENT = Presentation("%", 1e-4, 1)
_HECTARES = Presentation("ha", 1e-4, 2)
_HOURS = Presentation("h", 1 / 3600, 2)
_METRES = Presentation("m", 1e-3, 2)
_SECONDS = Presentation("s", 1e-3, 1)
_TOTAL_TRIGGERS = Trigger.TOTAL | Trigger.TIME | Trigger.CHANGE


def combine(implement: Implement, name: Name, *, designator: str, software_version: str, serial_number: str) -> Device:
    """The device: itself, a connector, and the header that harvests."""
    properties = []
    if implement.header_offset_m is not None:
        properties.append(Property(ddi.OFFSET_X, "Offset ahead", round(implement.header_offset_m * 1000), _METRES))
        properties.append(Property(ddi.OFFSET_Y, "Offset right", 0, _METRES))
    if implement.working_width_m is not None:
        properties.append(Property(ddi.WIDTH, "Working width", round(implement.working_width_m * 1000), _METRES))
    if implement.grain_delay_s is not None:
        # The value was true this long before it is sent.
        properties.append(Property(ddi.LATENCY, "Grain delay", -round(implement.grain_delay_s * 1000), _SECONDS))
    measured = [
        Variable(ddi.MASS_PER_TIME, "Mass flow", _KG_PER_S),
        Variable(ddi.DRY_PER_TIME, "Dry mass flow", _KG_PER_S),
        Variable(ddi.MOISTURE, "Moisture", _PERCENT),
        Variable(ddi.HOLD, "Yield hold"),
        Variable(ddi.TOTAL_MASS, "Mass", _KG, _TOTAL_TRIGGERS, settable=True),
        Variable(ddi.DRY_TOTAL, "Dry mass", _KG, _TOTAL_TRIGGERS, settable=True),
        Variable(ddi.EFFECTIVE_TIME, "Harvesting time", _HOURS, _TOTAL_TRIGGERS, settable=True),
    ]
    if implement.working_width_m is not None:
        measured += [
            Variable(ddi.MASS_PER_AREA, "Yield", _TONNES_PER_HECTARE),
            Variable(ddi.DRY_PER_AREA, "Dry yield", _TONNES_PER_HECTARE),
            Variable(ddi.TOTAL_AREA, "Area", _HECTARES, _TOTAL_TRIGGERS, settable=True),
        ]
    defaults = Variable(DEFAULTS_DDI, "Default data", None, Trigger.TOTAL, default=False)
    connector = Property(ddi.CONNECTOR_TYPE, "Connector", implement.connector_type)
    elements = (
        Element(ElementType.DEVICE, designator, variables=(defaults,)),
        Element(ElementType.CONNECTOR, "Connector", properties=(connector,)),
        Element(ElementType.FUNCTION, "Header", variables=tuple(measured), properties=tuple(properties)),
    )
    return Device(designator, software_version, name, serial_number, elements)


@dataclass(frozen=True, slots=True)
class Second:
    """What the monitor reports of one second; None: not known. Totals are its own; they begin anew with load first_load."""

    flow_kg_s: float | None
    total_kg: float
    harvesting: bool
    dry_flow_kg_s: float | None = None
    dry_total_kg: float | None = None
    moisture_pct: float | None = None
    ground_speed_m_s: float | None = None
    first_load: int = 1


def raw_values(second: Second, working_width_m: float | None, min_speed_m_s: float = 0.3) -> dict[int, int]:
    """DDI -> raw value of what is known; totals that this second does not carry (area, time) are the client's to count."""
    speed_m_s = second.ground_speed_m_s
    rate_m2_s = None
    if working_width_m is not None and speed_m_s is not None and speed_m_s >= min_speed_m_s:
        rate_m2_s = working_width_m * speed_m_s
    flow, dry = second.flow_kg_s, second.dry_flow_kg_s
    known: dict[int, float | None] = {
        ddi.MASS_PER_TIME: None if flow is None else flow * 1e6,
        ddi.DRY_PER_TIME: None if dry is None else dry * 1e6,
        ddi.MASS_PER_AREA: None if flow is None or rate_m2_s is None else flow / rate_m2_s * 1e6,
        ddi.DRY_PER_AREA: None if dry is None or rate_m2_s is None else dry / rate_m2_s * 1e6,
        ddi.MOISTURE: None if second.moisture_pct is None else second.moisture_pct * 1e4,
        ddi.TOTAL_MASS: second.total_kg,
        ddi.DRY_TOTAL: second.dry_total_kg,
        ddi.HOLD: float(not second.harvesting or flow is None),
    }
    return {number: min(max(0, round(value)), MOST) for number, value in known.items() if value is not None}
