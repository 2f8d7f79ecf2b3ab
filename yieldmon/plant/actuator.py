"""The plate's actuator: follows commands with a lag and a limited rate, and fails in the ways that real ones do."""

from __future__ import annotations

from enum import StrEnum
from math import degrees, exp
from typing import Annotated

import numpy as np
from pydantic import Field

from yieldmon.frames import ActuatorState, CommandMode, Frame, Unusable
from yieldmon.physics.machine import Machine
from yieldmon.strict_model import StrictModel


class ActuatorFault(StrEnum):
    """How the actuator misbehaves."""

    STUCK = "stuck"
    """The plate stays where it is; feedback is right."""
    SLOW = "slow"
    """A tenth of the rate."""
    SILENT = "silent"
    """No feedback frames."""
    LYING = "lying"
    """Feedback reports the target at once and the plate does not move."""
    NOISY = "noisy"
    """Feedback jumps about by a degree."""
    FAULT = "fault"
    """The actuator reports a fault and holds."""
    MANUAL = "manual"
    """Somebody else holds the plate."""


class ActuatorSettings(StrictModel):
    """Motion of the plate; angles in deg."""

    rate_deg_s: Annotated[float, Field(gt=0, le=90)] = 10.0
    lag_s: Annotated[float, Field(ge=0.01, le=5)] = 0.15
    feedback_noise_deg: Annotated[float, Field(ge=0, le=2)] = 0.02
    command_timeout_s: Annotated[float, Field(gt=0, le=60)] = 1.0


_REACHED_DEG = 0.1
_SLOW_SHARE = 0.1
_NOISY_DEG = 1.0


class PlateActuator:
    """State of the plate between commands. `angle_deg` is where the plate is, as the actuator would measure it."""

    def __init__(self, settings: ActuatorSettings, machine: Machine, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self._home = degrees(machine.home_plate_angle_rad)
        self._range = (degrees(machine.min_plate_angle_rad), degrees(machine.max_plate_angle_rad))
        self.angle_deg = self._home
        self.target_deg = self._home
        self._driven_until_s = -1.0
        self.fault: ActuatorFault | None = None

    def command(self, frame: Frame, time_s: float) -> None:
        """Take a PlateActuatorCommand; what is unusable or outside the plate's range is not followed."""
        if self.fault is ActuatorFault.MANUAL:
            return
        mode, target = frame.signals.get("CommandMode"), frame.signals.get("TargetPlateAngle")
        if mode == CommandMode.GO_HOME:
            target = self._home
        elif mode == CommandMode.RELEASE:
            self._driven_until_s = time_s
            self.target_deg = self.angle_deg
            return
        elif mode != CommandMode.GO_TO_ANGLE:
            return
        if target is None or isinstance(target, Unusable) or not self._range[0] <= target <= self._range[1]:
            return
        self.target_deg = float(target)
        self._driven_until_s = time_s + self._settings.command_timeout_s

    def step(self, time_s: float, interval_s: float) -> float:
        """Move for one interval that ends at time_s; returns the plate's angle, deg."""
        if time_s > self._driven_until_s and self.target_deg != self.angle_deg:
            self.target_deg = self.angle_deg
        if self.fault in (ActuatorFault.STUCK, ActuatorFault.LYING, ActuatorFault.FAULT, ActuatorFault.MANUAL):
            return self.angle_deg
        rate = self._settings.rate_deg_s * (_SLOW_SHARE if self.fault is ActuatorFault.SLOW else 1.0)
        wish = (self.target_deg - self.angle_deg) * (1.0 - exp(-interval_s / self._settings.lag_s))
        limit = rate * interval_s
        self.angle_deg += min(max(wish, -limit), limit)
        return self.angle_deg

    def feedback(self) -> tuple[float, ActuatorState] | None:
        """Measured angle (deg) and state as the feedback frame states them; None when silent."""
        if self.fault is ActuatorFault.SILENT:
            return None
        noise = self._settings.feedback_noise_deg * float(self._rng.standard_normal())
        if self.fault is ActuatorFault.LYING:
            return self.target_deg + noise, ActuatorState.IDLE
        if self.fault is ActuatorFault.NOISY:
            noise += _NOISY_DEG * float(self._rng.standard_normal())
        state = ActuatorState.MOVING if abs(self.target_deg - self.angle_deg) > _REACHED_DEG else ActuatorState.IDLE
        if self.fault is ActuatorFault.FAULT:
            state = ActuatorState.FAULT
        elif self.fault is ActuatorFault.MANUAL:
            state = ActuatorState.MANUAL
        return max(self.angle_deg + noise, 0.0), state
