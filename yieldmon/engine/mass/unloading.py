"""When the grain tank has been emptied, which ends a load.

Grain goes on coming while the tank is unloaded on the move, and leaves with the rest: a load ends when the unloading does.
"""

from __future__ import annotations

from math import isfinite

from yieldmon.engine.inputs import InputSnapshot
from yieldmon.engine.settings import EngineSettings
from yieldmon.frames import Unloading as Auger

_SHARE_OF_TANK = 0.5
"""Least share of the tank's mass that must be gone for the tank to count as emptied."""


class Unloading:
    """Follows one tank window by window, by a switch or by its scale, see `TotalsSettings.new_load`."""

    def __init__(self, settings: EngineSettings) -> None:
        follow = {"switch": self._by_switch, "tank_scale": self._by_scale}
        self._follow = follow.get(settings.totals.new_load)
        self._least_s = settings.totals.unloading_s
        self._play_kg = settings.reference_masses.unloading_kg
        self._on_s = 0.0
        self._over_s = 0.0
        self._highest_kg = float("-inf")
        self._lowest_kg = float("inf")

    def emptied(self, inputs: InputSnapshot, duration_s: float) -> bool:
        """Whether the tank counts as emptied with this window of duration_s, at whose end the inputs are held."""
        return self._follow is not None and self._follow(inputs, duration_s)

    def _by_switch(self, inputs: InputSnapshot, duration_s: float) -> bool:
        on = inputs.fresh["unloading"]
        if on == Auger.ON:
            self._on_s += duration_s
            self._over_s = 0.0
        elif on == Auger.OFF and self._on_s:
            self._over_s += duration_s
        if self._over_s < self._least_s or not self._on_s:
            return False
        emptied = self._on_s >= self._least_s
        self._on_s = self._over_s = 0.0
        return emptied

    def _by_scale(self, inputs: InputSnapshot, duration_s: float) -> bool:
        tank_kg = inputs.tank_kg
        if inputs.tank_disputed:
            self._highest_kg, self._lowest_kg, self._over_s = float("-inf"), float("inf"), 0.0
            return False
        if not isfinite(tank_kg):
            return False
        self._highest_kg = max(self._highest_kg, tank_kg)
        if self._highest_kg - tank_kg < max(self._play_kg, _SHARE_OF_TANK * self._highest_kg):
            return False
        if tank_kg < self._lowest_kg - self._play_kg:
            self._lowest_kg, self._over_s = tank_kg, 0.0
        self._over_s += duration_s
        if self._over_s < self._least_s:
            return False
        self._highest_kg, self._lowest_kg, self._over_s = tank_kg, float("inf"), 0.0
        return True
