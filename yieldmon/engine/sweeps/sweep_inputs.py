"""Inputs of a sweep: the plate at an instant, closed windows, and the reasons for an early end."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import degrees, isfinite

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.sampling.windows import Window
from yieldmon.frames import ActuatorState
from yieldmon.physics.machine import Machine


class SweepAbort(StrEnum):
    """Why a sweep ended early."""

    NOT_FOLLOWING = "the plate did not reach the commanded angle in time"
    NOT_SETTLING = "plate or signal did not settle"
    FEEDBACK_STALE = "no usable plate feedback"
    ACTUATOR_FAULT = "the actuator reports a fault"
    MANUAL = "the plate is held by hand or by another controller"
    FLOW_CHANGED = "the flow changed"
    SPEED_CHANGED = "the elevator speed changed"
    NOT_MEASURED = "flow was not measured"
    OPERATOR = "by the operator"
    FORCE_DOES_NOT_FOLLOW = "the force does not follow the angle that the plate reports"


@dataclass(frozen=True, slots=True)
class PlateReading:
    """The plate at one instant of engine time. angle_deg is nan while the feedback is stale."""

    time_s: float
    angle_deg: float
    state: ActuatorState


def plate_trouble(plate: PlateReading) -> SweepAbort | None:
    """Why no sweep can continue with this plate reading; None where it can."""
    if not isfinite(plate.angle_deg):
        return SweepAbort.FEEDBACK_STALE
    if plate.state is ActuatorState.MANUAL:
        return SweepAbort.MANUAL
    if plate.state is ActuatorState.FAULT:
        return SweepAbort.ACTUATOR_FAULT
    return None


@dataclass(frozen=True, slots=True)
class SweepWindow:
    """A closed window as input of a sweep.

    support_start_s: engine time of the earliest sample with weight. flow_kg_s: nan where it was not measured. whole: no part of
    it is missing or doubtful. still: the plate rested throughout. trend: see `windows.Window`.
    """

    end_s: float
    support_start_s: float
    flow_kg_s: float
    force_n: float
    speed_rad_s: float
    angle_deg: float
    whole: bool
    still: bool
    trend: float

    @classmethod
    def of(
        cls, window: Window, support_start_s: float, flow_kg_s: float, force_n: float, whole: bool, still: bool
    ) -> SweepWindow:
        """From a window and what was made of it."""
        return _sweep_window(
            window.end_s, support_start_s, flow_kg_s, force_n, window.speed_rad_s, degrees(window.plate_angle_rad), whole, still,
            window.trend,
        )  # fmt: skip


_sweep_window = maker_of(SweepWindow)


def support_start_s(window: Window, machine: Machine, max_ramp_s: float) -> float:
    """Engine time of the earliest sample with weight in a window: its near edge reaches into the window before, s."""
    chain = window.speed_rad_s * machine.sprocket_pitch_radius_m
    ramp_s = min(max_ramp_s, machine.pattern_length_m / chain) if chain > 0.0 else max_ramp_s
    return window.start_s - ramp_s
