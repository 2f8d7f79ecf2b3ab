"""The force cell behind the plate: what its voltage shows of the grain's impulses."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import numpy as np
import scipy
from pydantic import Field

from yieldmon.frames import SAMPLE_INTERVAL_S, SensorStatus
from yieldmon.physics.machine import LONGEST_RESPONSE_S, ImpactSensor
from yieldmon.physics.numerics import Array
from yieldmon.strict_model import StrictModel


class SensorFault(StrEnum):
    """How the sensor misbehaves."""

    STUCK = "stuck"
    """The same voltage in every sample."""
    SATURATED = "saturated"
    """Every sample at full scale, status over range."""
    FAULT = "fault"
    """Status fault; samples at zero volts."""
    SILENT = "silent"
    """No frames."""


class SensorSettings(StrictModel):
    """Zero, noise and response of the cell. Voltages in mV, forces in N."""

    zero_mv: Annotated[float, Field(ge=0, le=2000)] = 500.0
    drift_mv_per_sqrt_h: Annotated[float, Field(ge=0, le=100)] = 1.0
    temperature_mv_per_degc: Annotated[float, Field(ge=-10, le=10)] = 0.0
    noise_mv: Annotated[float, Field(ge=0, le=200)] = 3.0
    vibration_sprocket_n: Annotated[float, Field(ge=0, le=200)] = 3.0
    """Amplitude once per sprocket turn, also when empty; it grows with the square of the speed from 400 rpm."""
    vibration_paddle_n: Annotated[float, Field(ge=0, le=200)] = 3.0
    """Amplitude at paddle passing, likewise."""
    response_s: Annotated[float, Field(ge=0, le=LONGEST_RESPONSE_S)] = 0.008
    """Time constant of plate and cell, critically damped."""


class ImpactCell:
    """Turns force on the plate into samples, 1 ms each; keeps the state of the response between blocks."""

    def __init__(self, settings: SensorSettings, sensor: ImpactSensor, nonlinearity: float, steps_per_sample: int = 1) -> None:
        """steps_per_sample: steps in which the force is given and the response followed; a sample is their mean."""
        self._settings = settings
        self._sensor = sensor
        self._nonlinearity = nonlinearity
        self._full_scale_n = sensor.full_scale_mv * sensor.gain_n_per_mv
        step_s = SAMPLE_INTERVAL_S / steps_per_sample
        self._keep = float(np.exp(-step_s / settings.response_s)) if settings.response_s > 0.0 else 0.0
        self._steps = steps_per_sample
        self._state = np.zeros(2)
        self._stuck_mv: float | None = None

    def samples_mv(self, force_n: Array, background_mv: Array, fault: SensorFault | None) -> Array:
        """Voltages for the mean force in each step; background_mv: zero, noise and vibration in each sample."""
        felt, self._state = scipy.signal.lfilter(
            [(1.0 - self._keep) ** 2], [1.0, -2.0 * self._keep, self._keep**2], force_n, zi=self._state
        )
        if self._steps > 1:
            felt = felt.reshape(-1, self._steps).mean(axis=1)
        felt = felt * (1.0 - self._nonlinearity * felt / self._full_scale_n)
        voltage = np.clip(background_mv + felt / self._sensor.gain_n_per_mv, 0.0, self._sensor.full_scale_mv)
        if fault is SensorFault.STUCK:
            if self._stuck_mv is None:
                self._stuck_mv = float(voltage[0])
            return np.full_like(voltage, self._stuck_mv)
        self._stuck_mv = None
        if fault is SensorFault.SATURATED:
            return np.full_like(voltage, self._sensor.full_scale_mv)
        if fault is SensorFault.FAULT:
            return np.zeros_like(voltage)
        return np.asarray(voltage)

    def status(self, highest_mv: float, fault: SensorFault | None) -> SensorStatus:
        """Status that goes with samples up to highest_mv."""
        if fault is SensorFault.FAULT:
            return SensorStatus.FAULT
        return SensorStatus.OVER_RANGE if highest_mv >= self._sensor.full_scale_mv else SensorStatus.OK


def vibration_n(settings: SensorSettings, sprocket_turns: Array, pattern_turns: Array, speed_ratio: Array, paddles: int) -> Array:
    """Force of vibration, N: at the sprocket's turn and at paddle passing, growing with the square of speed_ratio.

    sprocket_turns, pattern_turns: turns of the sprocket and repeats of the paddle pattern since the start; paddles: per pattern.
    """
    once = settings.vibration_sprocket_n * np.sin(2.0 * np.pi * sprocket_turns + 0.4)
    passing = settings.vibration_paddle_n * np.sin(2.0 * np.pi * paddles * pattern_turns + 1.3)
    return (once + passing) * speed_ratio**2
