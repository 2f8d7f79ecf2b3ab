"""Block means of the map on a grid of degrees about square on the ground: mean, standard error, area and mass of each block."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians

import numpy as np

from .table import Array
from .tracks import Flags, Index

MAX_BLOCKS = 4_000_000
_DEG_M = 111_320.0
"""About: blocks need not be square to the metre."""


@dataclass(frozen=True)
class Grid:
    """Blocks with points, and the whole raster's place.

    Parameters
    ----------
    row, column : array of int
        Of each block, from the north-west corner.
    yield_kg_m2, standard_error_kg_m2 : array
        Mass over area, and the standard error of that mean from the spread of its points (NaN with one point).
    points : array of int
        Number of points.
    left_out : array
        Share of the points on the block that cleaning left out.
    west_deg, north_deg, width_deg, height_deg : float
        The raster's corner and a block's size.
    shape : (int, int)
        Rows and columns of the raster.
    """

    row: Index
    column: Index
    yield_kg_m2: Array
    standard_error_kg_m2: Array
    points: Index
    left_out: Array
    west_deg: float
    north_deg: float
    width_deg: float
    height_deg: float
    shape: tuple[int, int]

    def raster(self, values: Array) -> Array:
        """Shape `shape`, NaN where there is no block."""
        out = np.full(self.shape, np.nan)
        out[self.row, self.column] = values
        return out

    def fits(self) -> bool:
        """Whether a raster of it is not too large to write."""
        return self.shape[0] * self.shape[1] <= MAX_BLOCKS

    @property
    def size_m(self) -> float:
        """Of a block, from south to north."""
        return self.height_deg * _DEG_M

    def middle_deg(self) -> tuple[Array, Array]:
        """Longitude and latitude of the blocks' middles."""
        return self.west_deg + (self.column + 0.5) * self.width_deg, self.north_deg - (self.row + 0.5) * self.height_deg


def block_means(longitude_deg: Array, latitude_deg: Array, mass_kg: Array, area_m2: Array, kept: Flags, size_m: float) -> Grid:
    """Blocks of the kept points."""
    use = np.flatnonzero(kept & (area_m2 > 0))
    if not len(use):
        none = np.zeros(0)
        return Grid(
            row=none.astype(np.intp),
            column=none.astype(np.intp),
            yield_kg_m2=none,
            standard_error_kg_m2=none,
            points=none.astype(np.intp),
            left_out=none,
            west_deg=0.0,
            north_deg=0.0,
            width_deg=1.0,
            height_deg=1.0,
            shape=(1, 1),
        )
    middle = float(np.median(latitude_deg[use]))
    reference = float(longitude_deg[use][0])
    east = (longitude_deg - reference + 180.0) % 360.0 - 180.0
    height = size_m / _DEG_M
    width = height / max(cos(radians(middle)), 0.01)
    west, north = float(east[use].min()), float(latitude_deg[use].max())
    columns = int(np.ptp(east[use]) / width) + 1
    rows = int(np.ptp(latitude_deg[use]) / height) + 1

    def key_of(members: Index) -> Index:
        column = np.clip(((east[members] - west) / width).astype(np.intp), 0, columns - 1)
        row = np.clip(((north - latitude_deg[members]) / height).astype(np.intp), 0, rows - 1)
        return row * columns + column

    keys = key_of(use)
    blocks, inverse = np.unique(keys, return_inverse=True)
    count = np.bincount(inverse)
    mass, area = np.bincount(inverse, mass_kg[use]), np.bincount(inverse, area_m2[use])
    mean = mass / area
    off = mass_kg[use] / area_m2[use] - mean[inverse]
    weight = area_m2[use] / area[inverse]
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = np.bincount(inverse, (weight * off) ** 2) * count / (count - 1)
    inside = np.flatnonzero(
        ~kept
        & (east >= west)
        & (east <= west + columns * width)
        & (latitude_deg <= north)
        & (latitude_deg >= north - rows * height)
    )
    dropped = np.zeros(len(blocks))
    if len(inside):
        others = key_of(inside)
        place = np.minimum(np.searchsorted(blocks, others), len(blocks) - 1)
        hit = blocks[place] == others
        dropped = np.bincount(place[hit], minlength=len(blocks)).astype(float)
    return Grid(
        row=blocks // columns,
        column=blocks % columns,
        yield_kg_m2=mean,
        standard_error_kg_m2=np.where(count > 1, np.sqrt(variance), np.nan),
        points=count,
        left_out=dropped / (dropped + count),
        west_deg=west + reference,
        north_deg=north,
        width_deg=width,
        height_deg=height,
        shape=(rows, columns),
    )
