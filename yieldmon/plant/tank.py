"""The grain tank on its scale, and the loads that leave it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from yieldmon.frames import ScaleStatus
from yieldmon.strict_model import StrictModel


class TankSettings(StrictModel):
    """Size, unloading and scale of the tank. With `scale: off` there are no TankScale frames."""

    capacity_kg: Annotated[float, Field(gt=100, le=30000)] = 9000.0
    unload_from_kg: Annotated[float, Field(gt=0, le=30000)] = 4000.0
    """At a stop the tank is emptied when it holds this much; at capacity it is emptied at once."""
    unload_kg_s: Annotated[float, Field(gt=1, le=300)] = 80.0
    scale: bool = True
    scale_noise_kg: Annotated[float, Field(ge=0, le=500)] = 3.0
    scale_moving_noise_kg: Annotated[float, Field(ge=0, le=2000)] = 40.0
    scale_span_error_pct: Annotated[float, Field(ge=-20, le=20)] = 0.0


@dataclass(frozen=True, slots=True)
class Load:
    """A load that left the tank: when its unloading ended, and its mass."""

    time_s: float
    mass_kg: float


class Tank:
    """Mass in the tank, one second at a time."""

    def __init__(self, settings: TankSettings) -> None:
        self._settings = settings
        self.mass_kg = 0.0
        self.unloading = False
        self.loads: list[Load] = []
        self._unloaded_kg = 0.0

    def step(self, time_s: float, delivered_kg: float, working: bool) -> None:
        """Take what was delivered in the second that ends at time_s."""
        settings = self._settings
        self.mass_kg += delivered_kg
        wanted = settings.unload_from_kg if not working else settings.capacity_kg
        if self.mass_kg >= wanted:
            self.unloading = True
        if self.unloading:
            out = min(settings.unload_kg_s, self.mass_kg)
            self.mass_kg -= out
            self._unloaded_kg += out
            if self.mass_kg <= 0.0:
                self.loads.append(Load(time_s, self._unloaded_kg))
                self.unloading, self._unloaded_kg = False, 0.0

    def reading(self, working: bool, rng: np.random.Generator) -> tuple[float, ScaleStatus]:
        """Mass that the scale shows, kg, and whether it stands still."""
        settings = self._settings
        moving = working or self.unloading
        noise = (settings.scale_moving_noise_kg if moving else settings.scale_noise_kg) * float(rng.standard_normal())
        shown = self.mass_kg * (1.0 + settings.scale_span_error_pct / 100.0) + noise
        return shown, ScaleStatus.UNSTABLE if moving else ScaleStatus.STABLE
