"""The heap on a paddle, cut into parcels along the paddle.

The heap lies between the paddle, the circle through the tip and a straight inner surface that leaves the paddle at radius h0 and
meets the circle at angle shape_ratio (1 - h0/l) ahead of the paddle. Lengths here are in paddle lengths l.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from yieldmon.physics.numerics import Array


@dataclass(frozen=True, slots=True)
class Parcels:
    """Cells of equal width in sqrt(1 - radius): fine at the tip, where the time to leave the paddle changes fastest.

    radius: shape (heaps, cells), cell middles. area: same shape, cross section of each cell, l^2. reach_rad: how far ahead of
    the paddle the heap extends at that radius.
    """

    radius: Array
    area: Array
    reach_rad: Array


def cross_section(inner_radius: Array, shape_ratio: float) -> Array:
    """Area of the heap above its inner surface, in l^2, from the radius where that surface meets the paddle."""
    reach = shape_ratio * (1.0 - inner_radius)
    return 0.5 * reach - 0.5 * inner_radius * np.sin(reach)


def inner_radius(area: Array, shape_ratio: float) -> Array:
    """Radius where the inner surface meets the paddle, from the heap's cross section in l^2 (bisection).

    Raises ValueError for a heap above a full paddle (shape_ratio / 2).
    """
    area = np.asarray(area, dtype=float)
    if np.any(area > 0.5 * shape_ratio) or np.any(area < 0.0):
        raise ValueError(f"heap of {np.max(area):.4g} l^2 does not fit a paddle, which holds {0.5 * shape_ratio:.4g} l^2")
    low, high = np.zeros_like(area), np.ones_like(area)
    for _ in range(60):
        middle = 0.5 * (low + high)
        too_small = cross_section(middle, shape_ratio) < area
        high = np.where(too_small, middle, high)
        low = np.where(too_small, low, middle)
    return 0.5 * (low + high)


def _surface_radius(angle: Array, start: float, reach: float) -> Array:
    """Distance from the centre to the inner surface, seen under an angle ahead of the paddle."""
    return np.asarray(start * np.sin(reach) / (np.sin(reach - angle) + start * np.sin(angle)))


def cut(area: Array, shape_ratio: float, cells: int) -> Parcels:
    """Cut heaps of the given cross sections (shape (heaps,), l^2) into parcels along the paddle.

    The angular width of the heap at a radius comes from the surface itself, sampled and turned round; areas are scaled so that
    each heap keeps its cross section exactly.
    """
    start = inner_radius(area, shape_ratio)
    radius = np.empty((len(start), cells))
    cell_area, reach = np.empty_like(radius), np.empty_like(radius)
    for row, (x, total) in enumerate(zip(start, np.asarray(area, dtype=float), strict=True)):
        depth = np.sqrt(1.0 - x)
        edges = np.linspace(0.0, depth, cells + 1)
        middle = 0.5 * (edges[1:] + edges[:-1])
        radius[row] = 1.0 - middle**2
        ring = np.diff(edges) * 2.0 * middle * radius[row]
        reach[row] = _angular_width(radius[row], x, shape_ratio * (1.0 - x))
        cell_area[row] = ring * reach[row]
        cell_area[row] *= total / cell_area[row].sum()
    return Parcels(radius, cell_area, reach)


def _angular_width(radius: Array, start: float, reach: float) -> Array:
    angle = reach * np.linspace(0.0, 1.0, 401) ** 1.5
    surface = _surface_radius(angle, start, reach)
    surface[0], surface[-1] = start, 1.0
    rising = np.flatnonzero(np.diff(surface, prepend=-np.inf) > 0.0)
    # A deep heap's surface dips below h0 before it rises; what lies below h0 there is carried at h0.
    rising = rising[surface[rising] >= start]
    return scipy.interpolate.PchipInterpolator(surface[rising], angle[rising])(radius)
