"""Block means of the map on a grid of degrees about square on the ground: mean, standard error, area and mass of each block."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians

import numpy as np

from .table import Array, Flags, Index

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
    """Blocks of the kept points.

    Parameters
    ----------
    longitude_deg, latitude_deg, mass_kg, area_m2 : array, shape (n,)
        Of all points.
    kept : array of bool, shape (n,)
        Points that cleaning kept.
    size_m : float
        Of a block.

    Returns
    -------
    Grid
        Of no block where no kept point has an area.
    """
    use = np.flatnonzero(kept & (area_m2 > 0))
    if not len(use):
        return _NO_BLOCK
    raster = _Raster.over(longitude_deg[use], latitude_deg[use], size_m)
    blocks, inverse = np.unique(raster.block_of(longitude_deg[use], latitude_deg[use]), return_inverse=True)
    count = np.bincount(inverse)
    mass, area = np.bincount(inverse, mass_kg[use]), np.bincount(inverse, area_m2[use])
    mean = mass / area
    off = mass_kg[use] / area_m2[use] - mean[inverse]
    weight = area_m2[use] / area[inverse]
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = np.bincount(inverse, (weight * off) ** 2) * count / (count - 1)
    others = np.flatnonzero(~kept & raster.holds(longitude_deg, latitude_deg))
    dropped = _counts(blocks, raster.block_of(longitude_deg[others], latitude_deg[others]))
    return Grid(
        row=blocks // raster.columns,
        column=blocks % raster.columns,
        yield_kg_m2=mean,
        standard_error_kg_m2=np.where(count > 1, np.sqrt(variance), np.nan),
        points=count,
        left_out=dropped / (dropped + count),
        west_deg=raster.west_deg + raster.reference_deg,
        north_deg=raster.north_deg,
        width_deg=raster.width_deg,
        height_deg=raster.height_deg,
        shape=(raster.rows, raster.columns),
    )


_NO_BLOCK = Grid(
    row=np.zeros(0, np.intp),
    column=np.zeros(0, np.intp),
    yield_kg_m2=np.zeros(0),
    standard_error_kg_m2=np.zeros(0),
    points=np.zeros(0, np.intp),
    left_out=np.zeros(0),
    west_deg=0.0,
    north_deg=0.0,
    width_deg=1.0,
    height_deg=1.0,
    shape=(1, 1),
)


@dataclass(frozen=True)
class _Raster:
    """Rows and columns of blocks. west_deg is counted from reference_deg, -180 to 180: a field may lie across the date line."""

    reference_deg: float
    west_deg: float
    north_deg: float
    width_deg: float
    height_deg: float
    rows: int
    columns: int

    @classmethod
    def over(cls, longitude_deg: Array, latitude_deg: Array, size_m: float) -> _Raster:
        """That just holds these points."""
        reference = float(longitude_deg[0])
        east = _east_of(reference, longitude_deg)
        height = size_m / _DEG_M
        width = height / max(cos(radians(float(np.median(latitude_deg)))), 0.01)
        return cls(
            reference_deg=reference,
            west_deg=float(east.min()),
            north_deg=float(latitude_deg.max()),
            width_deg=width,
            height_deg=height,
            rows=int(np.ptp(latitude_deg) / height) + 1,
            columns=int(np.ptp(east) / width) + 1,
        )

    def block_of(self, longitude_deg: Array, latitude_deg: Array) -> Index:
        """Number of the block of each point, row by row from the north-west corner."""
        east = _east_of(self.reference_deg, longitude_deg)
        column = np.clip(((east - self.west_deg) / self.width_deg).astype(np.intp), 0, self.columns - 1)
        row = np.clip(((self.north_deg - latitude_deg) / self.height_deg).astype(np.intp), 0, self.rows - 1)
        return row * self.columns + column

    def holds(self, longitude_deg: Array, latitude_deg: Array) -> Flags:
        """Which points lie on the raster."""
        east = _east_of(self.reference_deg, longitude_deg)
        return (
            (east >= self.west_deg)
            & (east <= self.west_deg + self.columns * self.width_deg)
            & (latitude_deg <= self.north_deg)
            & (latitude_deg >= self.north_deg - self.rows * self.height_deg)
        )


def _east_of(reference_deg: float, longitude_deg: Array) -> Array:
    return (longitude_deg - reference_deg + 180.0) % 360.0 - 180.0


def _counts(blocks: Index, found: Index) -> Array:
    """How often each of the sorted block numbers is among those found."""
    place = np.minimum(np.searchsorted(blocks, found), len(blocks) - 1)
    return np.bincount(place[blocks[place] == found], minlength=len(blocks)).astype(float)
