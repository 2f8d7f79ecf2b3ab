"""The table of faults and the hysteresis that decides when each is shown.

Codes are the signal names of YieldMonitorStatus. SPN and FMI are what DM1 carries: suspect parameter numbers from the range that
J1939 leaves to manufacturers (520192 - 524287), failure modes of J1939-73.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum


class FaultCode(StrEnum):
    """Faults, by their signal in YieldMonitorStatus."""

    SENSOR_MISSING = "SensorMissing"
    SENSOR_STUCK = "SensorStuck"
    SENSOR_SATURATED = "SensorSaturated"
    ZERO_DRIFTED = "ZeroDrifted"
    SPEED_MISSING = "SpeedMissing"
    SPEED_OUT_OF_RANGE = "SpeedOutOfRange"
    PLATE_NOT_FOLLOWING = "PlateNotFollowing"
    PLATE_FEEDBACK_STALE = "PlateFeedbackStale"
    SWEEP_ABORTED = "SweepAborted"
    CALIBRATION_OLD = "CalibrationOld"
    FLOW_OUTSIDE_CALIBRATION = "FlowOutsideCalibration"
    NOT_IDENTIFIABLE = "NotIdentifiable"
    MODEL_DISAGREES = "ModelDisagrees"
    STORE_FAILING = "StoreFailing"
    FRAMES_LOST = "FramesLost"
    CLOCK_JUMPED = "ClockJumped"
    BUS_ERROR = "BusError"
    OUTPUT_CONFLICT = "OutputConflict"
    SCALE_FAULT = "ScaleFault"


class Severity(int, Enum):
    """Which lamp DM1 asks for."""

    NOTE = 0
    WARNING = 1
    STOP_TRUSTING = 2


@dataclass(frozen=True, slots=True)
class FaultDefinition:
    """One row of the table.

    set_after, clear_after: consecutive windows (s) for which the condition must hold, or be gone.
    """

    code: FaultCode
    spn: int
    fmi: int
    severity: Severity
    set_after: int
    clear_after: int
    cause: str
    effect: str
    remedy: str


_W, _N, _S = Severity.WARNING, Severity.NOTE, Severity.STOP_TRUSTING
_C = FaultCode

_TABLE = (
    FaultDefinition(
        _C.SENSOR_MISSING, 520192, 9, _S, 1, 3,
        "No usable ImpactSensorSamples for a second, or the sensor reports a fault of its own.",
        "No flow is published and no mass is added for the seconds without samples.",
        "Check the sensor's supply, connector and bus stub.",
    ),
    FaultDefinition(
        _C.SENSOR_STUCK, 520192, 2, _S, 1, 3,
        "Every sample has been the same for several seconds with the elevator turning.",
        "No flow is published and no mass is added.",
        "Check the plate for jamming and the sensor for a broken bridge.",
    ),
    FaultDefinition(
        _C.SENSOR_SATURATED, 520192, 0, _W, 1, 3,
        "Samples are at the end of the sensor's range, or the sensor says so.",
        "Flow is a lower bound and is marked as saturated.",
        "Reduce ground speed; check the zero-load voltage and the plate for wedged material.",
    ),
    FaultDefinition(
        _C.ZERO_DRIFTED, 520193, 13, _W, 3, 10,
        "The zero-load voltage has moved far from its first value.",
        "Flow is corrected for it, with less headroom before saturation; low flows are uncertain.",
        "Clean the plate, then run a zero calibration with the elevator empty.",
    ),
    FaultDefinition(
        _C.SPEED_MISSING, 520194, 9, _S, 1, 3,
        "No usable ElevatorSpeed for ten of its periods.",
        "No flow is published and no mass is added.",
        "Check the speed sensor and the node that sends ElevatorSpeed.",
    ),
    FaultDefinition(
        _C.SPEED_OUT_OF_RANGE, 520194, 1, _W, 2, 3,
        "The elevator turns at a speed outside the range in which grain is measured.",
        "No flow is published and no mass is added while it lasts.",
        "Bring the separator to its rated speed; check the elevator's belt.",
    ),
    FaultDefinition(
        _C.PLATE_NOT_FOLLOWING, 520195, 7, _W, 1, 10,
        "The plate did not reach a commanded angle in time, or the force did not follow the angle that it reports.",
        "Sweeps end early and wait longer each time; flow goes on at the measured angle.",
        "Check the actuator's linkage and supply for jamming.",
    ),
    FaultDefinition(
        _C.PLATE_FEEDBACK_STALE, 520195, 9, _W, 1, 3,
        "No usable PlateActuatorFeedback for ten of its periods, or the actuator reports a fault.",
        "With the plate last seen at rest its angle is held and flow is marked as degraded; otherwise no flow is published.",
        "Check the actuator's connector and bus stub.",
    ),
    FaultDefinition(
        _C.SWEEP_ABORTED, 520196, 31, _N, 1, 1,
        "The last sweep ended early; status names the reason.",
        "The parameters stay as they were; another sweep follows after a wait.",
        "None if it happens now and then; see the reason if it repeats.",
    ),
    FaultDefinition(
        _C.CALIBRATION_OLD, 520197, 13, _N, 1, 1,
        "The parameters were last calibrated or updated longer ago than configured.",
        "Flow may be biased by wear or crop; its standard deviation does not cover that.",
        "Weigh a load and enter the ticket, or let a sweep run.",
    ),
    FaultDefinition(
        _C.FLOW_OUTSIDE_CALIBRATION, 520198, 31, _N, 2, 5,
        "Force, angle or speed lies outside what was calibrated, or the flow is above a full paddle.",
        "Flow is extrapolated, or bounded by a full paddle, and marked.",
        "Calibrate over the range of flows that occur.",
    ),
    FaultDefinition(
        _C.NOT_IDENTIFIABLE, 520199, 31, _N, 1, 1,
        "The last sweep left what it was to determine as uncertain as before.",
        "The parameters stay as they were.",
        "Enter a scale ticket or use a tank scale; sweep at higher flow.",
    ),
    FaultDefinition(
        _C.MODEL_DISAGREES, 520200, 31, _W, 1, 1,
        "The residuals of several sweeps show a pattern that the model cannot make.",
        "Flow may be biased at some angles and loads; sweeps teach nothing, and what they alone had taught is taken back.",
        "Run diagnose on the store and adopt the effect that it proves.",
    ),
    FaultDefinition(
        _C.STORE_FAILING, 520201, 12, _W, 1, 3,
        "Records cannot be written to the store.",
        "Measuring goes on; totals since the last write are lost if power is cut.",
        "Free disk space or replace the storage.",
    ),
    FaultDefinition(
        _C.FRAMES_LOST, 520202, 19, _N, 1, 10,
        "The sample counter shows frames lost, or more frames than one sensor sends.",
        "The seconds concerned use the samples there are and are marked as degraded.",
        "Check bus load, termination and for a second node that sends samples.",
    ),
    FaultDefinition(
        _C.CLOCK_JUMPED, 520203, 2, _N, 1, 1,
        "Frame time stepped back or leapt forward.",
        "Windows and totals go on; records near the step carry odd times.",
        "None; check the logger's clock if it repeats.",
    ),
    FaultDefinition(
        _C.BUS_ERROR, 520204, 19, _W, 1, 3,
        "Error frames, bus-off or a lost interface.",
        "Frames are lost while it lasts.",
        "Check wiring, termination and bit rate.",
    ),
    FaultDefinition(
        _C.OUTPUT_CONFLICT, 520205, 19, _W, 1, 10,
        "Another node sends frames that only this monitor sends.",
        "Displays may show the other node's figures; the plate may be driven by it.",
        "Remove the second monitor or give it another address.",
    ),
    FaultDefinition(
        _C.SCALE_FAULT, 520206, 2, _N, 3, 5,
        "The tank scale reports a fault or went silent.",
        "It is not used as a reference.",
        "Check the scale.",
    ),
)

FAULTS: Mapping[FaultCode, FaultDefinition] = {row.code: row for row in _TABLE}
"""The table, in the order of the bits in YieldMonitorStatus."""


@dataclass(frozen=True, slots=True)
class FaultEvent:
    """A fault shown or withdrawn, in bus time."""

    time_s: float
    code: FaultCode
    active: bool
    detail: str


@dataclass(slots=True)
class _Entry:
    active: bool = False
    streak: int = 0
    occurrences: int = 0
    since_s: float = 0.0
    detail: str = ""


_KEPT_EVENTS = 1000


class FaultBook:
    """Which faults are shown. `observe` is called once a window for every code that the engine judges."""

    def __init__(self) -> None:
        self._entries = {code: _Entry() for code in FAULTS}
        self._reported: dict[FaultCode, str] = {}
        self._events: deque[FaultEvent] = deque(maxlen=_KEPT_EVENTS)

    def observe(self, code: FaultCode, present: bool, time_s: float, detail: str = "") -> None:
        """One window's verdict on a condition; shown or withdrawn once it has lasted as long as the table says."""
        definition, entry = FAULTS[code], self._entries[code]
        if not present and code in self._reported:
            present, detail = True, self._reported[code]
        if present and detail:
            entry.detail = detail
        if present == entry.active:
            entry.streak = 0
            return
        entry.streak += 1
        if entry.streak >= (definition.set_after if present else definition.clear_after):
            entry.active = present
            entry.streak = 0
            entry.since_s = time_s
            entry.occurrences += int(present)
            self._events.append(FaultEvent(time_s, code, present, entry.detail))

    def observe_all(self, present: Mapping[FaultCode, str], time_s: float) -> None:
        """One window's verdict on every condition; present: those that hold, with what is to be said of them."""
        for code, entry in self._entries.items():
            if code in present:
                self.observe(code, True, time_s, present[code])
            elif entry.active or entry.streak or code in self._reported:
                self.observe(code, False, time_s)

    def report(self, code: FaultCode, present: bool, detail: str = "") -> None:
        """What the service around the engine sees of a condition; it counts as present until reported otherwise."""
        if present:
            self._reported[code] = detail
        else:
            self._reported.pop(code, None)

    def is_active(self, code: FaultCode) -> bool:
        """Whether the fault is shown."""
        return self._entries[code].active

    @property
    def active(self) -> tuple[FaultCode, ...]:
        """Faults shown, in the table's order."""
        return tuple(code for code, entry in self._entries.items() if entry.active)

    def detail(self, code: FaultCode) -> str:
        """What was said when the condition was last seen."""
        return self._entries[code].detail

    def since(self, code: FaultCode) -> float:
        """Bus time at which the fault was last shown or withdrawn, s."""
        return self._entries[code].since_s

    def occurrences(self, code: FaultCode) -> int:
        """How often the fault has been shown."""
        return self._entries[code].occurrences

    def take_events(self) -> list[FaultEvent]:
        """Faults shown and withdrawn since the last call, at most the last thousand."""
        events = list(self._events)
        self._events.clear()
        return events
