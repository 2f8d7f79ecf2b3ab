"""Longitude and latitude as metres on a plane about a field, and back: equal-area, so that areas on it are areas on the ground.

The projection is the ellipsoid's sinusoidal one about the field's middle: north is the arc of the meridian, east the arc of the
parallel. It knows no zones, so a field may lie across one, on either hemisphere or across the 180th meridian.

Fields that lie far from each other have a plane each; on paper these planes lie side by side.

Source: Snyder, "Map projections: a working manual", US Geological Survey 1987, chapter 30 and equations 3-21, 30-8.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .table import Array

SEMI_MAJOR_M = 6_378_137.0
ECCENTRICITY_2 = 0.00669437999014

APART_M = 50_000.0
"""Points further than this from all points of a site are not of it."""
_OUTSIDE_M = 5_000.0
_CELL_M = 10_000.0
_MANY_CELLS = 20_000
_MIN_POINTS, _MIN_SHARE = 3, 0.01
"""What a group of points has at least to be a site; fewer have a wrong position, as have all at one place."""
_BESIDE_M = 1_000.0
_ASTRAY_M = 1e8
"""West of all sites: where points are put that belong to none."""


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
        """East and north, m; nan for a place that is not finite."""
        longitude_deg, latitude_deg = _finite(longitude_deg), _finite(latitude_deg)
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


@dataclass(frozen=True)
class Sites:
    """Planes of fields that are over APART_M from each other.

    Parameters
    ----------
    planes : tuple of Plane
        One a site, at least one.
    offset_m, left_m : tuple of float
        What is added to a site's east, so that the sites lie side by side, and where each then begins.
    reach_m : tuple of float
        From the middle of a site to its farthest point.
    """

    planes: tuple[Plane, ...]
    offset_m: tuple[float, ...]
    left_m: tuple[float, ...]
    reach_m: tuple[float, ...]

    @classmethod
    def about(cls, longitude_deg: Array, latitude_deg: Array) -> Sites:
        """About some points. Groups of under three points, of under a hundredth of all, or at one place are no site."""
        known = np.isfinite(longitude_deg) & np.isfinite(latitude_deg)
        longitude, latitude = np.asarray(longitude_deg)[known], np.asarray(latitude_deg)[known]
        planes: list[Plane] = []
        offsets, lefts, reaches = [], [], []
        beside_m = 0.0
        for members in _groups(longitude, latitude):
            plane = Plane.about(longitude[members], latitude[members])
            east, _ = plane.to_m(longitude[members], latitude[members])
            middle = _globe_m(np.array([plane.longitude_deg]), np.array([plane.latitude_deg]))
            off = np.linalg.norm(_globe_m(longitude[members], latitude[members]) - middle, axis=1)
            low, high = (float(east.min()), float(east.max())) if east.size else (0.0, 0.0)
            offsets.append(beside_m - low if planes else 0.0)
            lefts.append(offsets[-1] + low)
            beside_m = offsets[-1] + high + _BESIDE_M
            planes.append(plane)
            reaches.append(float(off.max()) if off.size else 0.0)
        return cls(tuple(planes), tuple(offsets), tuple(lefts), tuple(reaches))

    def to_m(self, longitude_deg: Array, latitude_deg: Array) -> tuple[Array, Array]:
        """East and north, m; `astray` marks the points that are of no site."""
        site = self._site_of(longitude_deg, latitude_deg)
        if site is None:
            return self.planes[0].to_m(longitude_deg, latitude_deg)
        east, north = self.planes[0].to_m(longitude_deg, latitude_deg)
        east = np.where(site < 0, east - _ASTRAY_M, east)
        for number, (plane, offset_m) in enumerate(zip(self.planes, self.offset_m, strict=True)):
            if number:
                here = site == number
                east[here], north[here] = plane.to_m(longitude_deg[here], latitude_deg[here])
                east[here] += offset_m
        return east, north

    def to_deg(self, east_m: Array, north_m: Array) -> tuple[Array, Array]:
        """Longitude and latitude, deg."""
        edges = [left_m - 0.5 * _BESIDE_M for left_m in self.left_m[1:]]
        site = np.searchsorted(edges, east_m, side="right")
        lost = astray(east_m)
        longitude, latitude = self.planes[0].to_deg(np.where(lost, east_m + _ASTRAY_M, east_m), north_m)
        for number in range(1, len(self.planes)):
            here = site == number
            if here.any():
                longitude[here], latitude[here] = self.planes[number].to_deg(east_m[here] - self.offset_m[number], north_m[here])
        return longitude, latitude

    def _site_of(self, longitude_deg: Array, latitude_deg: Array) -> NDArray[np.intp] | None:
        """The nearest site of each point, -1 for one that is of none; None where all are of the first."""
        places = _globe_m(longitude_deg, latitude_deg)
        nearest = np.zeros(len(places), np.intp)
        beyond = np.full(len(places), np.inf)
        for number, (plane, reach_m) in enumerate(zip(self.planes, self.reach_m, strict=True)):
            middle = _globe_m(np.array([plane.longitude_deg]), np.array([plane.latitude_deg]))
            further = np.linalg.norm(places - middle, axis=1) - reach_m
            nearer = further < beyond
            nearest[nearer], beyond[nearer] = number, further[nearer]
        with np.errstate(invalid="ignore"):
            nearest[np.isfinite(beyond) & (beyond > _OUTSIDE_M)] = -1
        return nearest if nearest.any() else None


def places_m(longitude_deg: Array, latitude_deg: Array) -> tuple[Array, Array]:
    """East and north of places on the planes about them, m, each of shape (n,); see Sites.to_m."""
    return Sites.about(longitude_deg, latitude_deg).to_m(longitude_deg, latitude_deg)


def astray(east_m: Array) -> NDArray[np.bool_]:
    """Which places of Sites.to_m belong to no site."""
    with np.errstate(invalid="ignore"):
        return np.asarray(east_m < -0.5 * _ASTRAY_M)


def _finite(values: Array) -> Array:
    """nan in place of infinities, of which a sine is worth a warning."""
    return np.where(np.isfinite(values), values, np.nan)


def _globe_m(longitude_deg: Array, latitude_deg: Array) -> Array:
    """Places on a globe, shape (n, 3)."""
    longitude, latitude = np.radians(_finite(longitude_deg)), np.radians(_finite(latitude_deg))
    flat = np.cos(latitude)
    return SEMI_MAJOR_M * np.column_stack((flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude)))


def _groups(longitude_deg: Array, latitude_deg: Array) -> list[NDArray[Any]]:
    """Members of each site, in the order of their first points; the largest group at least."""
    places = _globe_m(longitude_deg, latitude_deg)
    everyone = np.arange(len(places))
    if not len(places) or (np.linalg.norm(places - np.median(places, axis=0), axis=1) < APART_M).all():
        return [everyone]
    cells, cell_of, count = np.unique(np.round(places / _CELL_M), axis=0, return_inverse=True, return_counts=True)
    cell_of = cell_of.ravel()
    if len(cells) > _MANY_CELLS:
        # Positions scattered over the globe: only where some come together can a field be.
        often = count >= _MIN_POINTS
        if not often.any():
            return [everyone]
        new = np.cumsum(often) - 1
        kept = often[cell_of]
        everyone, cell_of = everyone[kept], new[cell_of[kept]]
        cells, count = cells[often], count[often]
    near = cKDTree(cells).query_pairs(APART_M / _CELL_M, output_type="ndarray")
    links = coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(len(cells), len(cells)))
    _, group_of_cell = connected_components(links, directed=False)
    size = np.bincount(group_of_cell, count)
    group = group_of_cell[cell_of]
    enough = (size >= max(_MIN_POINTS, _MIN_SHARE * len(places))) & _has_extent(places[everyone], group, len(size))
    if not enough.any():
        enough[int(np.argmax(size))] = True
    members = [everyone[group == number] for number in np.flatnonzero(enough)]
    return sorted(members, key=lambda rows: int(rows[0]))


def _has_extent(places: Array, group: NDArray[Any], count: int) -> NDArray[np.bool_]:
    """Which groups have more than one place: a place that says "not known" is one and the same."""
    first = np.zeros((count, 3))
    first[group[::-1]] = places[::-1]
    return np.bincount(group, (places != first[group]).any(axis=1), count) > 0


def wrapped_deg(angle_deg: Array) -> Array:
    """Within [-180, 180)."""
    return (angle_deg + 180.0) % 360.0 - 180.0


def _parallel_radius_m(latitude: Array) -> Array:
    return SEMI_MAJOR_M * np.cos(latitude) / np.sqrt(1.0 - ECCENTRICITY_2 * np.sin(latitude) ** 2)


def _meridian_radius_m(latitude: float) -> float:
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
