"""The vocabulary between bus, engine and plant: one frame as a message name with physical signal values.

It names the messages and signals of dbc/yieldmon.dbc and nothing of how they are packed.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple


class Unusable(Enum):
    """What J1939 sends in place of a value."""

    NOT_AVAILABLE = "not available"
    ERROR = "error"


NOT_AVAILABLE = Unusable.NOT_AVAILABLE
ERROR = Unusable.ERROR

Value = float | int | Unusable
#: A signal's physical value: float in the DBC's unit, int for counters and coded values (never a value-table object).


def number(value: object) -> float:
    """A signal's value as a float; nan for anything that is no finite number."""
    if isinstance(value, (int, float)):
        try:
            result = float(value)
        except OverflowError:
            return float("nan")
        return result if result - result == 0.0 else float("nan")
    return float("nan")


class Frame(NamedTuple):
    """One decoded frame.

    Parameters
    ----------
    time_s : float
        The bus's own time of reception, s, of any epoch: the engine uses differences only.
    message : str
        Name in the DBC.
    signals : mapping of str to float, int or Unusable
        Physical value by signal name, in the DBC's unit; int for counters and codes; `NOT_AVAILABLE` or `ERROR` in place of a
        value.

    Examples
    --------
    >>> api.Frame(3.5, "ElevatorSpeed", {"ElevatorSpeed": 400.0}).signals["ElevatorSpeed"]
    400.0
    """

    time_s: float
    message: str
    signals: Mapping[str, Value]


IMPACT_SENSOR_SAMPLES = "ImpactSensorSamples"
ELEVATOR_SPEED = "ElevatorSpeed"
PLATE_ACTUATOR_FEEDBACK = "PlateActuatorFeedback"
GRAIN_CONDITION = "GrainCondition"
TANK_SCALE = "TankScale"
PLATE_ACTUATOR_COMMAND = "PlateActuatorCommand"
MASS_FLOW = "MassFlow"
ACCUMULATED_MASS = "AccumulatedMass"
MASS_STD_DEV = "MassStdDev"
SELF_CALIBRATION_STATUS = "SelfCalibrationStatus"
YIELD_MONITOR_STATUS = "YieldMonitorStatus"
ACTIVE_DIAGNOSTICS = "ActiveDiagnostics"
HARVEST_STATE = "HarvestState"
GRAIN_TANK = "GrainTank"
GRAIN_KERNELS = "GrainKernels"
VEHICLE_POSITION = "VehiclePosition"
VEHICLE_DIRECTION_SPEED = "VehicleDirectionSpeed"
#: No message of the DBC: what a factory's own yield monitor says, whatever its layout.
FACTORY_MONITOR = "FactoryMonitor"

INPUTS = (
    IMPACT_SENSOR_SAMPLES,
    ELEVATOR_SPEED,
    PLATE_ACTUATOR_FEEDBACK,
    GRAIN_CONDITION,
    TANK_SCALE,
    HARVEST_STATE,
    GRAIN_TANK,
    GRAIN_KERNELS,
    VEHICLE_POSITION,
    VEHICLE_DIRECTION_SPEED,
)
OUTPUTS = (
    PLATE_ACTUATOR_COMMAND,
    MASS_FLOW,
    ACCUMULATED_MASS,
    MASS_STD_DEV,
    SELF_CALIBRATION_STATUS,
    YIELD_MONITOR_STATUS,
    ACTIVE_DIAGNOSTICS,
)

#: Samples in one ImpactSensorSamples frame (Sample0 .. Sample3), 1 ms apart, the last one at the frame's time.
SAMPLES_PER_FRAME = 4
SAMPLE_INTERVAL_S = 0.001


class SensorStatus(int, Enum):
    """ImpactSensorSamples.SensorStatus."""

    OK = 0
    OVER_RANGE = 1
    FAULT = 2


class ActuatorState(int, Enum):
    """PlateActuatorFeedback.ActuatorState."""

    IDLE = 0
    MOVING = 1
    FAULT = 2
    MANUAL = 3
    """An operator or another controller holds the plate; commands are ignored."""


class CommandMode(int, Enum):
    """PlateActuatorCommand.CommandMode."""

    RELEASE = 0
    """Not driving; the actuator holds where it is."""
    GO_TO_ANGLE = 1
    GO_HOME = 2


class ScaleStatus(int, Enum):
    """TankScale.TankScaleStatus."""

    STABLE = 0
    UNSTABLE = 1
    FAULT = 2


class EstimateQuality(int, Enum):
    """MassFlow.EstimateQuality: what the number beside it is worth."""

    OK = 0
    NOT_HARVESTING = 1
    """MassFlowRate is not available: no flow is being measured, which is not a flow of 0."""
    OUTSIDE_CALIBRATION = 2
    SATURATED = 3
    DEGRADED = 4
    """Measured, but with samples lost, an aged calibration or another fault that widens MassFlowStdDev."""
    SWEEPING = 5
    """Measured at a plate angle other than home, with the larger uncertainty that goes with it."""
    NOT_AVAILABLE = 6
    """An input is missing or broken; MassFlowRate is not available."""


class SweepState(int, Enum):
    """SelfCalibrationStatus.SweepState."""

    IDLE = 0
    WAITING = 1
    """Due, but conditions do not hold yet."""
    MOVING = 2
    SETTLING = 3
    MEASURING = 4
    RETURNING = 5
    ABORTED = 6
    UPDATED = 7
    """The last sweep changed the parameters."""
    NOT_LEARNED = 8
    """The last sweep ended well and the parameters stay: it said nothing new."""


class OperatingState(int, Enum):
    """YieldMonitorStatus.OperatingState."""

    STARTING = 0
    ZEROING = 1
    NOT_HARVESTING = 2
    HARVESTING = 3
    SWEEPING = 4
    FAULT = 5


class HeaderDown(int, Enum):
    """HarvestState.HeaderDown."""

    UP = 0
    DOWN = 1


FLICKER_S = 2.0
"""Longest time for which a header that is reported up within a pass is taken as a loose switch: none is lifted over a headland,
turned and lowered so soon."""


class WorkState(int, Enum):
    """HarvestState.WorkState."""

    NOT_WORKING = 0
    WORKING = 1


class Unloading(int, Enum):
    """GrainTank.Unloading."""

    OFF = 0
    ON = 1
