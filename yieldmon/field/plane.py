"""Longitude and latitude as metres on a plane about a field, and back: equal-area, so that areas on it are areas on the ground.

The projection is the ellipsoid's sinusoidal one about the field's middle: north is the arc of the meridian, east the arc of the
parallel. It knows no zones, so a field may lie across one, on either hemisphere or across the 180th meridian.

Source: Snyder, "Map projections: a working manual", US Geological Survey 1987, chapter 30 and equations 3-21, 30-8.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin, sqrt

import numpy as np

from .table import Array

SEMI_MAJOR_M = 6_378_137.0
ECCENTRICITY_2 = 0.00669437999014


@dataclass(frozen=True)
class Plane:
    """A plane about (longitude_deg, latitude_deg)."""

    longitude_deg: float
    latitude_deg: float

    @classmethod
    def about(cls, longitude_deg: Array, latitude_deg: Array) -> Plane:
        """About the median of some points; (0, 0) where none is known."""
        known = np.isfinite(longitude_deg) & np.isfinite(latitude_deg)
        if not known.any():
            return cls(0.0, 0.0)
        first = float(longitude_deg[known][0])
        around = float(np.median(wrapped_deg(longitude_deg[known] - first)))
        return cls(float(wrapped_deg(np.array(first + around))), float(np.median(latitude_deg[known])))

    def to_m(self, longitude_deg: Array, latitude_deg: Array) -> tuple[Array, Array]:
        """East and north, m."""
        latitude = np.radians(latitude_deg)
        east = np.radians(wrapped_deg(longitude_deg - self.longitude_deg)) * _parallel_radius_m(latitude)
        north = _meridian_m(latitude) - _meridian_m(np.array(radians(self.latitude_deg)))
        return east, north

    def to_deg(self, east_m: Array, north_m: Array) -> tuple[Array, Array]:
        """Longitude and latitude, deg."""
        arc = north_m + _meridian_m(np.array(radians(self.latitude_deg)))
        middle = radians(self.latitude_deg)
        latitude = middle + north_m / _meridian_radius_m(middle)
        for _ in range(3):
            latitude = latitude - (_meridian_m(latitude) - arc) / _meridian_radius_m(middle)
        longitude = self.longitude_deg + np.degrees(east_m / _parallel_radius_m(latitude))
        return wrapped_deg(longitude), np.degrees(latitude)


def wrapped_deg(angle_deg: Array) -> Array:
    """Within [-180, 180)."""
    return (angle_deg + 180.0) % 360.0 - 180.0


def _parallel_radius_m(latitude: Array) -> Array:
    return SEMI_MAJOR_M * np.cos(latitude) / np.sqrt(1.0 - ECCENTRICITY_2 * np.sin(latitude) ** 2)


def _meridian_radius_m(latitude: float) -> float:
    assert cos(latitude) >= 0.0
    return SEMI_MAJOR_M * (1.0 - ECCENTRICITY_2) / sqrt(1.0 - ECCENTRICITY_2 * sin(latitude) ** 2) ** 3


def _meridian_m(latitude: Array) -> Array:
    e2, e4, e6 = ECCENTRICITY_2, ECCENTRICITY_2**2, ECCENTRICITY_2**3
    arc: Array = SEMI_MAJOR_M * (
        (1 - e2 / 4 - 3 * e4 / 64 - 5 * e6 / 256) * latitude
        - (3 * e2 / 8 + 3 * e4 / 32 + 45 * e6 / 1024) * np.sin(2 * latitude)
        + (15 * e4 / 256 + 45 * e6 / 1024) * np.sin(4 * latitude)
        - (35 * e6 / 3072) * np.sin(6 * latitude)
    )
    return arc
