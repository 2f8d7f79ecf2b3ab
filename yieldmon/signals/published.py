"""What can be published: each quantity with its unit, and the shipped message and signal that bring its value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from yieldmon import frames as bus
from yieldmon.engine.faults import FAULTS
from yieldmon.frames import CommandMode, EstimateQuality, OperatingState, SweepState

FRAME_COUNTER = "frame_counter"


@dataclass(frozen=True, slots=True)
class Published:
    """One quantity.

    unit: of its values. message, signal: of the shipped DBC that carry it; "" for what only the second's record says. codes: its
    values where these are codes. counts: whether it counts on from 0 where a signal ends.
    """

    unit: str
    message: str = ""
    signal: str = ""
    codes: tuple[int, ...] = ()
    counts: bool = False


def _codes(kind: type[CommandMode | EstimateQuality | OperatingState | SweepState]) -> tuple[int, ...]:
    return tuple(int(code) for code in kind)


PUBLISHED: Mapping[str, Published] = {
    "mass_flow": Published("kg/s", bus.MASS_FLOW, "MassFlowRate"),
    "mass_flow_std_dev": Published("kg/s", bus.MASS_FLOW, "MassFlowStdDev"),
    "estimate_quality": Published("", bus.MASS_FLOW, "EstimateQuality", _codes(EstimateQuality)),
    "window_counter": Published("", bus.MASS_FLOW, "WindowCounter", counts=True),
    "load_mass": Published("kg", bus.ACCUMULATED_MASS, "LoadMass"),
    "total_mass": Published("kg", bus.ACCUMULATED_MASS, "TotalMass"),
    "load_number": Published("", bus.ACCUMULATED_MASS, "LoadNumber", counts=True),
    "load_mass_std_dev": Published("kg", bus.MASS_STD_DEV, "LoadMassStdDev"),
    "total_mass_std_dev": Published("kg", bus.MASS_STD_DEV, "TotalMassStdDev"),
    "moisture": Published("%"),
    "dry_mass_flow": Published("kg/s"),
    "dry_load_mass": Published("kg"),
    "dry_total_mass": Published("kg"),
    "sweep_state": Published("", bus.SELF_CALIBRATION_STATUS, "SweepState", _codes(SweepState)),
    "sweep_progress": Published("%", bus.SELF_CALIBRATION_STATUS, "SweepProgress"),
    "calibration_age": Published("min", bus.SELF_CALIBRATION_STATUS, "CalibrationAge"),
    "operating_state": Published("", bus.YIELD_MONITOR_STATUS, "OperatingState", _codes(OperatingState)),
    "active_faults": Published(""),
    **{
        f"fault_{code.name.lower()}": Published("", bus.YIELD_MONITOR_STATUS, code.value, (0, 1))
        for code in FAULTS
    },
    "plate_target_angle": Published("deg", bus.PLATE_ACTUATOR_COMMAND, "TargetPlateAngle"),
    "plate_command_mode": Published("", bus.PLATE_ACTUATOR_COMMAND, "CommandMode", _codes(CommandMode)),
    "plate_command_counter": Published("", bus.PLATE_ACTUATOR_COMMAND, "CommandCounter", counts=True),
    FRAME_COUNTER: Published("", counts=True),
}  # fmt: skip
"""Quantities by name. `frame_counter` counts the frames of the message that carries it."""

CARRIED: Mapping[tuple[str, str], str] = {
    (entry.message, entry.signal): name for name, entry in PUBLISHED.items() if entry.message
}
"""Shipped message and signal -> quantity."""
