"""Whether the tank's scale shows that grain has come in."""

from __future__ import annotations

from collections import deque
from math import isfinite

from yieldmon.engine.inputs import InputSnapshot

_TANK_S = 60.0
"""Time over which stable readings of the tank scale are compared."""
_TANK_RISE = 3.0
"""Least rise that means grain, in standard deviations of the scale."""


class TankRise:
    """The tank's mass over the last minute.

    Parameters
    ----------
    scale_std_dev_kg : float
        Standard deviation of the scale, kg.
    """

    def __init__(self, scale_std_dev_kg: float) -> None:
        self._least_kg = _TANK_RISE * scale_std_dev_kg
        self._readings: deque[tuple[float, float]] = deque()

    def see(self, inputs: InputSnapshot) -> None:
        """Take the reading held at a window's end; none counts while two scales disagree."""
        readings = self._readings
        if inputs.tank_disputed:
            readings.clear()
        elif isfinite(inputs.tank_kg) and (not readings or inputs.tank_time_s > readings[-1][0]):
            readings.append((inputs.tank_time_s, inputs.tank_kg))
        while readings and inputs.time_s - readings[0][0] > _TANK_S:
            readings.popleft()

    @property
    def sign_of_grain(self) -> str:
        """The rise of the tank mass in words, "" where it is within the scale's noise."""
        if len(self._readings) < 2:
            return ""
        (first_s, first_kg), (last_s, last_kg) = self._readings[0], self._readings[-1]
        if not last_kg - first_kg > self._least_kg:
            return ""
        return f"the tank has gained {last_kg - first_kg:.0f} kg in {last_s - first_s:.0f} s"
