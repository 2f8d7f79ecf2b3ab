"""Names of parameter groups met on farm machines (SAE J1939-21, -71, -73, -81; ISO 11783-3, -7, -10; NMEA 2000)."""

from __future__ import annotations

NAMES: dict[int, str] = {
    0: "Torque/Speed Control 1", 1024: "External Brake Request", 51968: "Process Data", 58880: "Virtual Terminal to Node",
    59136: "Node to Virtual Terminal", 59392: "Acknowledgment", 59904: "Request", 60160: "Transport Protocol Data Transfer",
    60416: "Transport Protocol Connection Management", 60928: "Address Claimed", 61184: "Proprietary A",
    61440: "Electronic Retarder Controller 1", 61441: "Electronic Brake Controller 1",
    61442: "Electronic Transmission Controller 1", 61443: "Electronic Engine Controller 2",
    61444: "Electronic Engine Controller 1", 61445: "Electronic Transmission Controller 2",
    61446: "Electronic Axle Controller 1", 61459: "Slope Sensor Information", 61474: "Machine Selected Speed",
    61481: "Slope Sensor Information 2", 61482: "Angular Rate Information", 61485: "Acceleration Sensor",
    64892: "Diesel Particulate Filter Control 1",
    64947: "Aftertreatment 1 Outlet Gas 2", 64991: "Front Wheel Drive Status", 65037: "Working Set Master",
    65089: "Lighting Command", 65091: "Rear Power Take-Off Output Shaft", 65092: "Front Power Take-Off Output Shaft",
    65093: "Rear Hitch Status", 65094: "Front Hitch Status", 65095: "Maintain Power", 65096: "Wheel-Based Speed and Distance",
    65097: "Ground-Based Speed and Distance", 65110: "Aftertreatment 1 Diesel Exhaust Fluid Tank", 65128: "Vehicle Fluids",
    65129: "Engine Temperature 3", 65217: "High Resolution Vehicle Distance", 65226: "DM1 Active Diagnostic Trouble Codes",
    65227: "DM2 Previously Active Trouble Codes", 65237: "Alternator Information", 65240: "Commanded Address",
    65242: "Software Identification", 65247: "Electronic Engine Controller 3", 65248: "Vehicle Distance",
    65251: "Engine Configuration 1", 65253: "Engine Hours, Revolutions", 65254: "Time/Date", 65255: "Vehicle Hours",
    65256: "Vehicle Direction/Speed", 65257: "Fuel Consumption (Liquid)", 65259: "Component Identification",
    65260: "Vehicle Identification", 65262: "Engine Temperature 1", 65263: "Engine Fluid Level/Pressure 1",
    65264: "Power Take-Off Information", 65265: "Cruise Control/Vehicle Speed", 65266: "Fuel Economy (Liquid)",
    65267: "Vehicle Position", 65269: "Ambient Conditions", 65270: "Intake/Exhaust Conditions 1",
    65271: "Vehicle Electrical Power 1", 65272: "Transmission Fluids 1", 65276: "Dash Display", 126208: "NMEA Group Function",
    126464: "NMEA PGN List", 126720: "Proprietary A2", 126992: "System Time", 126993: "Heartbeat", 126996: "Product Information",
    127250: "Vessel Heading", 129025: "Position, Rapid Update", 129026: "COG and SOG, Rapid Update",
    129029: "GNSS Position Data",
}  # fmt: skip
_FIRST_PROPRIETARY_B, _LAST_PROPRIETARY_B = 65280, 65535


def group_name(group: int) -> str | None:
    """Name of a parameter group; None for one that is not known here."""
    if _FIRST_PROPRIETARY_B <= group <= _LAST_PROPRIETARY_B:
        return "Proprietary B"
    return NAMES.get(group)
