"""Collects seconds with kernel noise until they make a measurement that updates the parameters."""

from __future__ import annotations

from math import sqrt

from yieldmon.engine.measurement import Reading
from yieldmon.engine.settings import WaveformSettings
from yieldmon.estimation.waveform.common_bias import KernelMeasurement, measurement_of


class KernelMeasurements:
    """Takes one second out of each averaging time of kernel noise, so that their random errors are independent."""

    def __init__(self, settings: WaveformSettings) -> None:
        self._settings = settings
        self._windows = 0
        self._seconds: list[tuple[float, float, float, float, float]] = []
        self._random_sds: list[float] = []
        self._lasting_sd = 0.0

    def add(self, kernels_kg_s: float, relative_sd: float, random_sd: float, reading: Reading) -> None:
        """A second at home with a flow by kernel noise."""
        if not self._settings.update_parameters:
            return
        self._windows += 1
        if self._windows % self._settings.kernel_windows:
            return
        window = reading.window
        self._seconds.append(
            (kernels_kg_s, reading.force_n, window.plate_angle_rad, window.speed_rad_s, reading.inputs.fresh["moisture"])
        )
        self._random_sds.append(random_sd)
        self._lasting_sd = max(self._lasting_sd, sqrt(max(relative_sd**2 - random_sd**2, 0.0)))

    def take(self) -> KernelMeasurement | None:
        """The measurement, once there are enough seconds, else None; then it begins anew."""
        if not self._seconds or self._windows < self._settings.update_windows:
            return None
        found = measurement_of(self._seconds, self._random_sds, self._lasting_sd)
        self._windows, self._lasting_sd = 0, 0.0
        self._seconds, self._random_sds = [], []
        return found
