"""A synthetic field: passes north and south, side by side, driven while the header is in the crop."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians
from typing import Annotated

from pydantic import Field

from yieldmon.strict_model import StrictModel

_M_PER_DEG_LATITUDE = 111_195.0


class FieldSettings(StrictModel):
    """Where the field lies and how it is driven."""

    latitude_deg: Annotated[float, Field(ge=-80, le=80)] = 40.0621
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] = -88.1957
    ground_speed_km_h: Annotated[float, Field(ge=0.5, le=20)] = 6.0
    swath_m: Annotated[float, Field(ge=1, le=20)] = 9.1


@dataclass(frozen=True, slots=True)
class Position:
    """Position, heading (deg from north, clockwise) and ground speed."""

    latitude_deg: float
    longitude_deg: float
    bearing_deg: float
    ground_speed_km_h: float


class Track:
    """Drives the field: north, over by one swath while out of the crop, south, and so on."""

    def __init__(self, settings: FieldSettings) -> None:
        self._settings = settings
        self._north_m = 0.0
        self._east_m = 0.0
        self._heading = 1.0
        self._passes = 0
        self._was_working = False

    def step(self, interval_s: float, working: bool) -> Position:
        """Drive on for an interval; where the machine is then."""
        settings = self._settings
        if self._was_working and not working:
            self._passes += 1
            self._heading = -self._heading
        self._was_working = working
        speed_m_s = settings.ground_speed_km_h / 3.6
        if working:
            self._north_m += self._heading * speed_m_s * interval_s
            bearing = 0.0 if self._heading > 0.0 else 180.0
            shown = settings.ground_speed_km_h
        else:
            over = self._passes * settings.swath_m - self._east_m
            step = min(over, 0.5 * speed_m_s * interval_s)
            self._east_m += step
            bearing, shown = 90.0, step / interval_s * 3.6
        east_scale = _M_PER_DEG_LATITUDE * cos(radians(settings.latitude_deg))
        return Position(
            settings.latitude_deg + self._north_m / _M_PER_DEG_LATITUDE,
            settings.longitude_deg + self._east_m / east_scale,
            bearing,
            shown,
        )
