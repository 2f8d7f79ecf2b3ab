"""What changes slowly over a scenario: moisture and temperature of the grain, and with them the cell's zero."""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.plant.scenario import Scenario


@dataclass(frozen=True)
class CropCourse:
    """From the crop's values at the start to those at the end, in proportion to time."""

    scenario: Scenario

    def _between(self, start: float, end: float | None, time_s: float) -> float:
        return start if end is None else start + (end - start) * min(time_s / self.scenario.duration_s, 1.0)

    def moisture_pct(self, time_s: float) -> float:
        """Of the grain."""
        return self._between(self.scenario.crop.moisture_pct, self.scenario.crop.end_moisture_pct, time_s)

    def temperature_degc(self, time_s: float) -> float:
        """Of the grain."""
        return self._between(self.scenario.crop.temperature_degc, self.scenario.crop.end_temperature_degc, time_s)

    def zero_mv(self, time_s: float) -> float:
        """Voltage of the cell without load, without its random walk."""
        settings = self.scenario.sensor
        warmer = self.temperature_degc(time_s) - self.scenario.crop.temperature_degc
        return settings.zero_mv + settings.temperature_mv_per_degc * warmer
