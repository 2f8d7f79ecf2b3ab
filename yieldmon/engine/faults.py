"""The table of faults: what each means, when it is present, and for how long it must be before it is shown.

A condition is a function of an `Observation`, one window and what is known beside it; judging changes nothing.

Codes are the signal names of YieldMonitorStatus. SPN and FMI are what DM1 carries: suspect parameter numbers from the range that
J1939 leaves to manufacturers (520192 - 524287), failure modes of J1939-73.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum
from math import ceil, isfinite
from typing import TYPE_CHECKING, NamedTuple

from yieldmon.frames import ScaleStatus
from yieldmon.physics.machine import RPM

if TYPE_CHECKING:
    from yieldmon.engine.flow import Flow
    from yieldmon.engine.inputs import InputSnapshot
    from yieldmon.engine.measurement import Reading
    from yieldmon.engine.sampling.windows import Window
    from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome
    from yieldmon.engine.settings import EngineSettings
    from yieldmon.engine.sweeps.disagreement import Disagreement
    from yieldmon.engine.sweeps.sweep import SweepMachine
    from yieldmon.engine.waveform.waveform_reading import WaveformReading


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
    NETWORK_FAULT = "NetworkFault"
    ZERO_MISSING = "ZeroMissing"
    WAVEFORM_CONTRADICTS = "WaveformContradicts"
    MASS_NEAR_END = "MassNearEnd"
    SCALE_DISAGREES = "ScaleDisagrees"


class Severity(int, Enum):
    """Which lamp DM1 asks for."""

    NOTE = 0
    WARNING = 1
    STOP_TRUSTING = 2


class Observation(NamedTuple):
    """What the conditions are judged on: a window, its flow as measured, and the state of sweep and calibration after it."""

    reading: Reading
    flow: Flow
    sweep: SweepMachine
    outcome: CalibrationOutcome | None
    disagreement: Disagreement
    calibration_age_s: float | None
    settings: EngineSettings
    waveform: WaveformReading
    mass_near_end: str | None
    scale_alarm: str | None

    @property
    def window(self) -> Window:
        """The window."""
        return self.reading.window

    @property
    def speed_rpm(self) -> float:
        """Elevator speed in the window."""
        return self.reading.window.speed_rad_s / RPM

    @property
    def sensor_saturated(self) -> bool:
        """Whether too many samples are at the end of the sensor's range."""
        return self.reading.window.saturated_share >= self.settings.windows.saturated_share


@dataclass(frozen=True, slots=True)
class FaultDefinition:
    """One row of the table.

    set_after, clear_after: consecutive windows (s) for which the condition must hold, or be gone. present: what is to be said
    of the condition where it holds, else None; None for a condition that the service reports.
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
    present: Callable[[Observation], str | None] | None


def _if(present: bool) -> str | None:
    return "" if present else None


def _saturated_detail(o: Observation) -> str:
    share = f"{100.0 * o.window.saturated_share:.0f} % of the samples"
    if o.window.ceiling_mv == 0.0:
        return share
    return (
        f"{share} are cut off at {o.window.ceiling_mv:.0f} mV: the amplifier's end, or full_scale_mv of the machine file is wrong"
    )


_UNUSABLE = 0.01
"""Share of the samples that came, from which those that cannot be used are named."""
_MANY_LOST, _ROOM_FOR_LOST = 5, 0.25
"""Frames in a second, and the share of them for which its samples leave room."""


def _frames_lost(o: Observation) -> bool:
    if o.window.lost_frames > 0 or o.window.contested or o.reading.inputs.tank_disputed:
        return True
    # A sensor that starts or stops within a window covers a part of it and has lost nothing.
    began = not o.reading.sampled_before
    ended = o.window.end_s - o.window.last_frame_s > o.settings.inputs.sensor_timeout_s
    return 0.0 < o.window.coverage < o.settings.windows.full_coverage and not (began or ended)


def _frames_lost_detail(o: Observation) -> str:
    disputed = [name for name in (o.window.disputed, "tank mass" if o.reading.inputs.tank_disputed else "") if name]
    rivals = f"; two nodes send {' and '.join(disputed)}" if disputed else ""
    if o.window.lost_frames == 0 and o.window.surplus_frames == 0 and not rivals:
        # By the counters none is missing: as many as the counters have room for are, or the times are not those of the samples.
        covered = f"samples for {100.0 * o.window.coverage:.0f} % of the second"
        if unusable := _unusable_share(o):
            return f"{covered}; of those that came {100.0 * unusable:.0f} % are not available or beyond what the sensor can give"
        return f"{covered}, no frame missing: if it lasts, is rate_hz right?"
    if o.window.lost_frames == 0 and not rivals:
        rivals = ": a second sender, or more samples per second than rate_hz says"
    if not rivals and _counted_otherwise(o):
        rivals = "; samples cover the second all the same: they come in bursts, or the mapping's counter counts otherwise"
    return f"{o.window.lost_frames} lost, {o.window.surplus_frames} too many{rivals}"


def _unusable_share(o: Observation) -> float:
    """Of the samples that came those that cannot be used; 0 below `_UNUSABLE`."""
    sent = o.window.frames * ceil(o.window.samples / max(o.window.frames, 1))
    share = 1.0 - o.window.samples / sent if sent else 0.0
    return share if share >= _UNUSABLE else 0.0


def _counted_otherwise(o: Observation) -> bool:
    """Whether the samples' times leave no room for the frames that the counter says are lost."""
    lost = o.window.lost_frames
    room = (1.0 - o.window.coverage) * (o.window.frames + lost)
    return lost >= _MANY_LOST and room < _ROOM_FOR_LOST * lost


def _scale_fault(inputs: InputSnapshot) -> str | None:
    if not isfinite(inputs.scale_status):
        return None
    status = inputs.fresh["tank_scale_status"]
    if not isfinite(status):
        return "silent"
    return "reports a fault" if status == ScaleStatus.FAULT.value else None


def _zero_missing(o: Observation) -> str | None:
    refusal, settings = o.reading.zero_refusal, o.settings
    if refusal is None or refusal.waited_s < settings.faults.zero_missing_s:
        return None
    if refusal.obstacle:
        return f"no zero in {refusal.waited_s:.0f} s: {refusal.obstacle}"
    limits = settings.zero
    return (
        f"no zero in {refusal.waited_s:.0f} s: pulses of {refusal.pulse_mv:.1f} mV (limit {limits.first_pulse_limit_mv:g} mV), "
        f"level within {refusal.level_range_mv:.1f} mV (limit {limits.level_range_mv:g} mV)"
    )


REPORTED = None
"""The service around the engine sees the condition, see `health.FaultBook.report`."""


_W, _N, _S = Severity.WARNING, Severity.NOTE, Severity.STOP_TRUSTING
_C = FaultCode

# fmt: off
_TABLE = (
    FaultDefinition(
        _C.SENSOR_MISSING, 520192, 9, _S, 1, 3,
        "No usable impact samples for a second, or the sensor reports a fault of its own.",
        "No flow is published and no mass is added for the seconds without samples.",
        "Check the sensor's supply, connector and bus stub.",
        lambda o: (
            f"{o.window.samples} usable samples in the window"
            if o.window.samples == 0 or 2 * o.window.sensor_fault_frames > o.window.frames
            else None
        ),
    ),
    FaultDefinition(
        _C.SENSOR_STUCK, 520192, 2, _S, 1, 3,
        "Every sample has been the same for several seconds with the elevator turning.",
        "No flow is published and no mass is added.",
        "Check the plate for jamming and the sensor for a broken bridge.",
        lambda o: (
            f"no change for {o.reading.stuck_s} s" if o.reading.stuck_s >= o.settings.faults.stuck_windows else None
        ),
    ),
    FaultDefinition(
        _C.SENSOR_SATURATED, 520192, 0, _W, 1, 3,
        "Samples are at the end of the sensor's range, or the sensor reports it.",
        "Flow is a lower bound and is marked as saturated.",
        "Reduce ground speed; check the zero-load voltage and the plate for wedged material.",
        lambda o: _saturated_detail(o) if o.sensor_saturated else None,
    ),
    FaultDefinition(
        _C.ZERO_DRIFTED, 520193, 13, _W, 3, 10,
        "The zero-load voltage is far from its first value or was taken despite signs of grain, or the plate reads below empty.",
        "Flow is corrected for a drift; a zero taken with grain on the plate makes flow and mass too small.",
        "Undo a wrong zero (yieldmon zero --undo); else clean the plate and calibrate the zero with the elevator empty. "
        "A new sensor's sign may be wrong (negative scale).",
        lambda o: o.reading.zero_drift or None,
    ),
    FaultDefinition(
        _C.SPEED_MISSING, 520194, 9, _S, 1, 3,
        "No usable elevator speed for ten of its periods.",
        "No flow is published and no mass is added.",
        "Check the speed sensor, its node, and unit and scale of its mapping.",
        lambda o: _if(not o.reading.speed_known),
    ),
    FaultDefinition(
        _C.SPEED_OUT_OF_RANGE, 520194, 1, _W, 2, 3,
        "The elevator turns at a speed outside the range in which grain is measured.",
        "No flow is published and no mass is added while it lasts.",
        "Bring the separator to its rated speed; check the elevator's belt.",
        lambda o: (
            f"{o.speed_rpm:.0f} rpm"
            if o.reading.speed_known and o.speed_rpm > o.settings.gate.min_turning_rpm and not o.reading.in_range
            else None
        ),
    ),
    FaultDefinition(
        _C.PLATE_NOT_FOLLOWING, 520195, 7, _W, 1, 10,
        "The plate did not reach a commanded angle in time, or the force did not follow the angle that it reports.",
        "Sweeps end early and the wait before the next grows; flow is measured at the angle that is reported.",
        "Check the actuator's linkage and supply for jamming.",
        lambda o: _if(o.sweep.not_following),
    ),
    FaultDefinition(
        _C.PLATE_FEEDBACK_STALE, 520195, 9, _W, 1, 3,
        "No usable plate angle for ten of its periods, or the actuator reports a fault.",
        "With the plate last seen at rest its angle is held and flow is marked as degraded; otherwise no flow is published.",
        "Check the actuator's connector and bus stub.",
        lambda o: _if(o.reading.inputs.angle_stale),
    ),
    FaultDefinition(
        _C.SWEEP_ABORTED, 520196, 31, _N, 1, 1,
        "The last sweep ended early; status names the reason.",
        "The parameters stay as they were; another sweep follows after a wait.",
        "None if it happens now and then; see the reason if it repeats.",
        lambda o: str(o.sweep.abort_reason) if o.sweep.abort_reason is not None else None,
    ),
    FaultDefinition(
        _C.CALIBRATION_OLD, 520197, 13, _N, 1, 1,
        "The parameters were last calibrated or updated longer ago than configured.",
        "Flow may be biased by wear or crop; its standard deviation does not cover that.",
        "Weigh a load and enter the ticket, or let a sweep run.",
        lambda o: _if(o.calibration_age_s is not None and o.calibration_age_s > o.settings.faults.calibration_old_s),
    ),
    FaultDefinition(
        _C.FLOW_OUTSIDE_CALIBRATION, 520198, 31, _N, 2, 5,
        "Force, angle or speed lies outside what was calibrated, or the flow is above a full paddle.",
        "Flow is extrapolated, or bounded by a full paddle, and marked.",
        "Calibrate over the range of flows that occur.",
        lambda o: (
            f"{o.flow.rate_kg_s:.1f} kg/s"
            # What is left of the grain at a stop is below any calibrated flow, and no matter.
            if (o.flow.out_of_calibration and o.flow.force_n > o.settings.gate.grain_on_n)
            or (o.flow.saturated and not o.sensor_saturated)
            else None
        ),
    ),
    FaultDefinition(
        _C.NOT_IDENTIFIABLE, 520199, 31, _N, 1, 1,
        "The last sweep left what it was to determine as uncertain as before.",
        "The parameters stay as they were.",
        "Enter a scale ticket or use a tank scale; sweep at higher flow.",
        lambda o: o.outcome.reason if o.outcome is not None and not (o.outcome.identifiable or o.outcome.weighed) else None,
    ),
    FaultDefinition(
        _C.MODEL_DISAGREES, 520200, 31, _W, 1, 1,
        "The residuals of several sweeps show a pattern that the model cannot make.",
        "Flow may be biased at some angles and loads; sweeps change no parameter, and what rests on them alone is undone.",
        "Run diagnose on the store and adopt the effect that it proves.",
        lambda o: o.disagreement.region if o.disagreement.present else None,
    ),
    FaultDefinition(
        _C.STORE_FAILING, 520201, 12, _W, 1, 3,
        "Records cannot be written to the store.",
        "Measuring continues; totals since the last write are lost if power is cut.",
        "Free disk space or replace the storage.",
        REPORTED,
    ),
    FaultDefinition(
        _C.FRAMES_LOST, 520202, 19, _N, 1, 10,
        "The sample counter shows frames lost, or two nodes send samples, speed, plate angle or tank mass.",
        "The seconds concerned are degraded; with two senders their mass is counted apart.",
        "Check bus load, termination and for second senders.",
        lambda o: _frames_lost_detail(o) if _frames_lost(o) else None,
    ),
    FaultDefinition(
        _C.CLOCK_JUMPED, 520203, 2, _N, 1, 1,
        "Frame time stepped back or leapt forward.",
        "Windows and totals continue; records near the step have wrong times.",
        "None; check the logger's clock if it repeats.",
        lambda o: _if(o.reading.windows_since_jump < o.settings.faults.clock_jump_hold_windows),
    ),
    FaultDefinition(
        _C.BUS_ERROR, 520204, 19, _W, 1, 3,
        "Error frames, bus-off or a lost interface.",
        "Frames are lost while it lasts.",
        "Check wiring, termination and bit rate.",
        REPORTED,
    ),
    FaultDefinition(
        _C.OUTPUT_CONFLICT, 520205, 19, _W, 1, 10,
        "Another node sends frames that only this monitor sends.",
        "Displays may show the other node's figures; the plate may be driven by it.",
        "Remove the second monitor.",
        REPORTED,
    ),
    FaultDefinition(
        _C.SCALE_FAULT, 520206, 2, _N, 3, 5,
        "The tank scale reports a fault or went silent.",
        "It is not used as a reference.",
        "Check the scale.",
        lambda o: _scale_fault(o.reading.inputs),
    ),
    FaultDefinition(
        _C.NETWORK_FAULT, 520207, 19, _W, 1, 3,
        "No address could be claimed, or another node contests it, uses our NAME, or floods us with requests or sessions.",
        "Without an address nothing is published and the plate is not driven; measuring continues.",
        "Give one of the nodes another address or NAME; find the node that status names.",
        REPORTED,
    ),
    FaultDefinition(
        _C.ZERO_MISSING, 520193, 31, _S, 1, 1,
        "The elevator runs and no zero-load voltage could be taken; the detail says why.",
        "No flow is published and no mass is added until there is a zero.",
        "Run the elevator empty. If it is empty, the paddles shake the plate: check its mounting, then calibrate the zero.",
        _zero_missing,
    ),
    FaultDefinition(
        _C.WAVEFORM_CONTRADICTS, 520208, 31, _W, 3, 10,
        "Flow from the pulses' shape or kernels and from the mean force differ beyond deviation, or no pulse of the model fits.",
        "One is wrong; the flow is the mean force's.",
        "Weigh a load; check plate, density, kernel weight; run diagnose on the store.",
        lambda o: o.waveform.contradiction or None,
    ),
    FaultDefinition(
        _C.MASS_NEAR_END, 520209, 0, _W, 1, 1,
        "The load's or the total mass is near the largest that its signal in AccumulatedMass carries.",
        "Beyond that the signal is not available; the store and status continue to count.",
        "Start a new load; archive the totals.",
        lambda o: o.mass_near_end,
    ),
    FaultDefinition(
        _C.SCALE_DISAGREES, 520210, 31, _W, 1, 1,
        "A weighed mass contradicts the calibration (p < 0.001).",
        "Mass since the named load is off by about that error; the scale is learnt from the weighed masses.",
        "Check the ticket, then chain slip, paddle wear and sensor gain. Ends with a weighed mass that agrees or a calibration.",
        lambda o: o.scale_alarm,
    ),
)
# fmt: on

FAULTS: Mapping[FaultCode, FaultDefinition] = {row.code: row for row in _TABLE}
"""The table, in the order of the bits in YieldMonitorStatus."""
