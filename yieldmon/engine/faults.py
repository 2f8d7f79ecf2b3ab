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
    from yieldmon.engine.sweeps.sweep import PlateSweep
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
    sweep: PlateSweep
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
            return f"{covered}; {100.0 * unusable:.0f} % of the received samples are not available or outside the sensor's range"
        return f"{covered}, no frame missing: if this persists, check rate_hz"
    if o.window.lost_frames == 0 and not rivals:
        rivals = ": a second sender, or more samples per second than rate_hz says"
    if not rivals and o.reading.silent_before:
        rivals = "; they were lost while no samples came"
    elif not rivals and _counted_otherwise(o):
        rivals = "; samples cover the whole second: they arrive in bursts, or the mapping's counter is wrong"
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


_STRUCK_S = 5
"""How long grain must strike the plate of an elevator that is reported to stand: longer than one takes to run down."""


def _speed_missing(o: Observation) -> str | None:
    if not o.reading.speed_known:
        return ""
    if o.reading.speed_contradicted:
        return f"{o.speed_rpm:.0f} rpm, but the pulses of the grain come at another rate"
    if o.reading.struck_s < _STRUCK_S:
        return None
    return f"{o.speed_rpm:.0f} rpm, but grain strikes the plate"


REPORTED = None
"""The service around the engine sees the condition, see `health.FaultBook.report`."""


_W, _N, _S = Severity.WARNING, Severity.NOTE, Severity.STOP_TRUSTING
_C = FaultCode

# fmt: off
_TABLE = (
    FaultDefinition(
        _C.SENSOR_MISSING, 520192, 9, _S, 1, 3,
        "The impact sensor sent no usable samples for a second, or reports a fault.",
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
        "All samples have been equal for several seconds while the elevator turns.",
        "No flow is published and no mass is added.",
        "Check for a jammed plate and a broken sensor bridge.",
        lambda o: (
            f"no change for {o.reading.stuck_s} s" if o.reading.stuck_s >= o.settings.faults.stuck_windows else None
        ),
    ),
    FaultDefinition(
        _C.SENSOR_SATURATED, 520192, 0, _W, 1, 3,
        "Samples are at the limit of the sensor's range, or the sensor reports that they are.",
        "The true flow is higher than shown; its quality is saturated.",
        "Reduce ground speed. Check the zero-load voltage, and the plate for wedged material.",
        lambda o: _saturated_detail(o) if o.sensor_saturated else None,
    ),
    FaultDefinition(
        _C.ZERO_DRIFTED, 520193, 13, _W, 3, 10,
        "The zero-load voltage is far from its first value or the empty plate, moved in grain, or taken despite signs of grain.",
        "Slow drift is corrected. A zero far from the empty plate makes flow and mass wrong, one taken with grain too small.",
        "Undo a wrong zero (yieldmon zero --undo). Otherwise clean the plate and run yieldmon zero with the elevator empty. "
        "If the sensor is new, check its sign (negative scale).",
        lambda o: o.reading.zero_drift or None,
    ),
    FaultDefinition(
        _C.SPEED_MISSING, 520194, 9, _S, 1, 3,
        "No usable elevator speed was received for ten of its periods, or the grain's pulses contradict it.",
        "No flow is published and no mass is added.",
        "Check the speed sensor, its node, and the unit and scale in its mapping.",
        _speed_missing,
    ),
    FaultDefinition(
        _C.SPEED_OUT_OF_RANGE, 520194, 1, _W, 2, 3,
        "The elevator speed is outside the measuring range.",
        "No flow is published and no mass is added until the speed is back in range.",
        "Run the separator at its rated speed. Check the elevator drive belt.",
        lambda o: (
            f"{o.speed_rpm:.0f} rpm"
            if o.reading.speed_known and o.speed_rpm > o.settings.gate.min_turning_rpm and not o.reading.in_range
            else None
        ),
    ),
    FaultDefinition(
        _C.PLATE_NOT_FOLLOWING, 520195, 7, _W, 1, 10,
        "The plate did not reach a commanded angle in time, or the force did not follow the reported angle.",
        "Sweeps end early and the wait before the next grows. Flow is measured at the reported angle.",
        "Check the actuator's linkage for jamming, and its supply.",
        lambda o: _if(o.sweep.not_following),
    ),
    FaultDefinition(
        _C.PLATE_FEEDBACK_STALE, 520195, 9, _W, 1, 3,
        "No usable plate angle was received for ten of its periods, or the actuator reports a fault.",
        "If the plate was at rest, its last angle is used and the quality is degraded. Otherwise no flow is published.",
        "Check the actuator's connector and bus stub.",
        lambda o: _if(o.reading.inputs.angle_stale),
    ),
    FaultDefinition(
        _C.SWEEP_ABORTED, 520196, 31, _N, 1, 1,
        "The last sweep ended early; yieldmon status gives the reason.",
        "The parameters are unchanged; the next sweep follows after a wait.",
        "Nothing if it happens occasionally. If it repeats, act on the reason.",
        lambda o: str(o.sweep.abort_reason) if o.sweep.abort_reason is not None else None,
    ),
    FaultDefinition(
        _C.CALIBRATION_OLD, 520197, 13, _N, 1, 1,
        "The last calibration or update is older than faults.calibration_old_s.",
        "Wear or another crop may bias the flow; its standard deviation does not include this.",
        "Weigh a load and enter the ticket, or let a sweep run.",
        lambda o: _if(o.calibration_age_s is not None and o.calibration_age_s > o.settings.faults.calibration_old_s),
    ),
    FaultDefinition(
        _C.FLOW_OUTSIDE_CALIBRATION, 520198, 31, _N, 2, 5,
        "Force, angle or speed is outside the calibrated range, or the flow exceeds full paddles.",
        "Flow is extrapolated, or limited to full paddles, and marked.",
        "Calibrate over the range of flows that you harvest.",
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
        "The last sweep did not make the parameters more certain.",
        "The parameters are unchanged.",
        "Enter a scale ticket or use a tank scale. Sweep at higher flow.",
        lambda o: o.outcome.reason if o.outcome is not None and not (o.outcome.identifiable or o.outcome.weighed) else None,
    ),
    FaultDefinition(
        _C.MODEL_DISAGREES, 520200, 31, _W, 1, 1,
        "The residuals of several sweeps show a pattern that the model cannot explain.",
        "Flow may be biased at some angles and loads. Sweeps update nothing; updates based on sweeps alone are undone.",
        "Run yieldmon diagnose on the store and adopt the effect that it finds.",
        lambda o: o.disagreement.region if o.disagreement.present else None,
    ),
    FaultDefinition(
        _C.STORE_FAILING, 520201, 12, _W, 1, 3,
        "The daemon cannot write records to the store.",
        "Measuring continues. If power fails, the totals since the last write are lost.",
        "Free disk space or replace the storage.",
        REPORTED,
    ),
    FaultDefinition(
        _C.FRAMES_LOST, 520202, 19, _N, 1, 10,
        "The sample counter shows frames lost, or two nodes send samples, speed, plate angle or tank mass.",
        "The quality of these seconds is degraded. With two senders their mass is counted separately.",
        "Check bus load and termination, and look for a second sender.",
        lambda o: _frames_lost_detail(o) if _frames_lost(o) else None,
    ),
    FaultDefinition(
        _C.CLOCK_JUMPED, 520203, 2, _N, 1, 1,
        "The frames' time stamps jumped back or forward.",
        "Measuring and totals continue. Records near the jump have wrong times.",
        "Nothing if it happens once. If it repeats, check the computer's or logger's clock.",
        lambda o: _if(o.reading.windows_since_jump < o.settings.faults.clock_jump_hold_windows),
    ),
    FaultDefinition(
        _C.BUS_ERROR, 520204, 19, _W, 1, 3,
        "The bus reports error frames or bus-off, or the interface is gone.",
        "Frames are lost.",
        "Check wiring, termination and bit rate.",
        REPORTED,
    ),
    FaultDefinition(
        _C.OUTPUT_CONFLICT, 520205, 19, _W, 1, 10,
        "Another node sends frames that only this monitor sends.",
        "Displays may show the other node's figures, and it may drive the plate.",
        "Stop the second monitor or replay.",
        REPORTED,
    ),
    FaultDefinition(
        _C.SCALE_FAULT, 520206, 2, _N, 3, 5,
        "The tank scale reports a fault or sends no frames.",
        "The tank scale is not used as a reference.",
        "Check the scale and its connection.",
        lambda o: _scale_fault(o.reading.inputs),
    ),
    FaultDefinition(
        _C.NETWORK_FAULT, 520207, 19, _W, 1, 3,
        "yieldmon could claim no address, or another node contests it, uses its NAME, or sends too many requests or sessions.",
        "Without an address yieldmon sends nothing and does not drive the plate. Measuring continues.",
        "Find the node that yieldmon status names. Give one of the two another address or NAME.",
        REPORTED,
    ),
    FaultDefinition(
        _C.ZERO_MISSING, 520193, 31, _S, 1, 1,
        "The elevator runs, but no zero-load voltage could be measured; the detail gives the reason.",
        "No flow is published and no mass is added until a zero is measured.",
        "Run the elevator empty. If it is empty, the paddles shake the plate: check its mounting, then run yieldmon zero.",
        _zero_missing,
    ),
    FaultDefinition(
        _C.WAVEFORM_CONTRADICTS, 520208, 31, _W, 3, 10,
        "Pulse shape or kernel noise contradicts the mean force, or the pulses do not fit the model or elevator speed.",
        "One of the two is wrong. The published flow is that of the mean force.",
        "Weigh a load. Check speed, plate, density and kernel weight. Run yieldmon diagnose on the store.",
        lambda o: o.waveform.contradiction or o.reading.speed_doubt or None,
    ),
    FaultDefinition(
        _C.MASS_NEAR_END, 520209, 0, _W, 1, 1,
        "The load's or the total mass is near the limit of its signal in AccumulatedMass.",
        "Above the limit the signal is not available. The store and yieldmon status continue to count.",
        "Start a new load. For the total: archive, then reset the totals.",
        lambda o: o.mass_near_end,
    ),
    FaultDefinition(
        _C.SCALE_DISAGREES, 520210, 31, _W, 1, 1,
        "A weighed mass contradicts the calibration (p < 0.001).",
        "Mass since the named load is wrong by about that error. The weighed masses update the scale.",
        "Check the ticket, then chain slip, paddle wear and sensor gain. An agreeing weighed mass or a calibration ends it.",
        lambda o: o.scale_alarm,
    ),
)
# fmt: on

FAULTS: Mapping[FaultCode, FaultDefinition] = {row.code: row for row in _TABLE}
"""The table, in the order of the bits in YieldMonitorStatus."""
