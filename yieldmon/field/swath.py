"""Ground newly cut by each point: the swath between the point before and this one, less what was cut earlier.

A swath is the quadrilateral between the header's edges at two points. Neighbouring swaths of a pass share an edge, so a pass has
neither gaps nor overlaps of its own. What swaths before it in time cover is taken off exactly, as polygons.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from .table import Array, Flags, HarvestTable, Index
from .tracks import Tracks, row_headings

CHUNK = 20_000
MIN_OVERLAP = 1e-4
"""Share of a swath below which an overlap is a rounding error of positions."""
_WHOLE_PERCENTILE, _LEAST_SPARE, _LEAST_LOST = 95.0, 0.1, 0.1
"""Width that counts as the whole header's; shares of a width that is spare, and of the ground that a stretch loses, from which
it is asked at which side a part of the header cuts."""
_MAX_EDGE_TURN = np.cos(np.radians(60.0))
Shapes = NDArray[np.object_]


@dataclass(frozen=True)
class Swaths:
    """The ground of each row of a table.

    Parameters
    ----------
    corners_m : array, shape (n, 4, 2)
        Back left, back right, front right, front left; NaN where nothing was cut.
    cut : array of bool, shape (n,)
        Rows that have a swath.
    gross_m2, area_m2 : array, shape (n,)
        Area of the swath and of the ground newly cut in it; 0 where nothing was cut.
    overlapped : array of int
        Rows that lost ground to earlier ones.
    shapes : array of polygons
        What is left of each of these.
    """

    corners_m: Array
    cut: Flags
    gross_m2: Array
    area_m2: Array
    overlapped: Index
    shapes: Shapes

    def polygons(self, rows: Index) -> Shapes:
        """New ground of some rows as polygons on the plane; empty ones where nothing is left."""
        out = _polygons(self.corners_m[rows])
        place = np.full(len(self.cut), -1, np.intp)
        place[self.overlapped] = np.arange(len(self.overlapped))
        changed = place[rows] >= 0
        out[changed] = self.shapes[place[rows][changed]]
        out[~self.cut[rows]] = shapely.Polygon()
        return out


def swaths(table: HarvestTable, steps: Tracks) -> Swaths:
    """The ground of each row, in order of time.

    Parameters
    ----------
    table, steps
        A harvest, with the places of the header's middle, and its tracks.
    """
    lanes = _lanes(table, steps)
    right = np.nan_to_num(table["cut_right_m"])
    found = _less_earlier(lanes.order, *lanes.corners(right))
    moved = _beside_cut_ground(table, steps, lanes, found)
    if not moved.any():
        return found
    return _less_earlier(lanes.order, *lanes.corners(right + moved))


def _less_earlier(order: Index, corners: Array, cut: Flags) -> Swaths:
    """The ground of each row without that of rows before it."""
    gross = np.zeros(len(order))
    area = np.zeros(len(order))
    rows = order[cut[order]]
    shapes = _polygons(corners[rows])
    gross[rows] = area[rows] = shapely.area(shapes)
    later, earlier = _overlaps(shapes, corners[rows], area[rows])
    changed, left = _remaining(shapes, later, earlier)
    area[rows[changed]] = shapely.area(left)
    return Swaths(corners, cut, gross, area, rows[changed], left)


def _beside_cut_ground(table: HarvestTable, steps: Tracks, lanes: _Lanes, found: Swaths) -> Array:
    """By how much to the right of the header's middle the part lies that cuts, m, where a source has its width only.

    The rest of the header is over ground that was cut: a stretch of one width that would lose ground in the middle lies at the
    side where it loses least.
    """
    width = np.nan_to_num(table["width_m"])
    moved = np.zeros(len(table))
    stream = steps.stream[steps.step_of_row]
    # Another crop or field may have another header.
    labels = (table.labels[name].codes for name in ("crop", "field"))
    _, header = np.unique(np.column_stack((stream, *labels)), axis=0, return_inverse=True)
    header = header.reshape(-1)
    spare = np.zeros(len(table))
    for one in range(int(header.max(initial=-1)) + 1):
        mine = (header == one) & found.cut
        if mine.any():
            spare[mine] = float(np.percentile(width[mine], _WHOLE_PERCENTILE)) - width[mine]
    narrow = found.cut & (spare > _LEAST_SPARE * width) & np.isnan(table["cut_right_m"]) & ~np.isfinite(table["section"])
    if not narrow.any():
        return moved
    rows = lanes.order[narrow[lanes.order]]
    keys = np.column_stack((stream[rows], steps.pass_number[steps.step_of_row[rows]], np.round(width[rows], 2)))
    stretch = np.cumsum((np.diff(keys, axis=0, prepend=np.nan) != 0).any(axis=1)) - 1
    lost = np.bincount(stretch, (found.gross_m2 - found.area_m2)[rows])
    whole = np.bincount(stretch, found.gross_m2[rows])
    asked = (lost > _LEAST_LOST * whole)[stretch]
    rows, stretch = rows[asked], stretch[asked]
    if not rows.size:
        return moved
    every = lanes.order[found.cut[lanes.order]]
    place = np.empty(len(table), np.intp)
    place[every] = np.arange(len(every))
    tree, ground = shapely.STRtree(_polygons(found.corners_m[every])), found.polygons(every)
    best, least = np.zeros(len(lost)), lost
    number = np.full(len(table), -1, np.intp)
    number[rows] = stretch
    for side in (-0.5, 0.5):
        corners, _ = lanes.corners(np.where(number >= 0, side * spare, 0.0))
        shapes = _polygons(corners[rows])
        one, other = tree.query(shapes)
        before = (other < place[rows][one]) & (number[every[other]] != stretch[one])
        one, other = one[before], other[before]
        taken = np.bincount(stretch[one], shapely.area(shapely.intersection(shapes[one], ground[other])), len(lost))
        better = taken < least - _LEAST_LOST * whole
        best, least = np.where(better, side, best), np.where(better, taken, least)
    moved[rows] = best[stretch] * spare[rows]
    return moved


@dataclass(frozen=True)
class _Lanes:
    """Places, headings and widths of the rows, from which the corners of their swaths follow; and the rows in order of time."""

    order: Index
    x: Array
    y: Array
    back_x: Array
    back_y: Array
    sin: Array
    cos: Array
    back_sin: Array
    back_cos: Array
    half: Array
    may_cut: Flags

    def corners(self, right_m: Array) -> tuple[Array, Flags]:
        """Of swaths so far to the right of the places, and which rows cut."""
        one, other = right_m - self.half, right_m + self.half
        corners = np.stack(
            [
                np.column_stack((self.back_x + one * self.back_cos, self.back_y - one * self.back_sin)),
                np.column_stack((self.back_x + other * self.back_cos, self.back_y - other * self.back_sin)),
                np.column_stack((self.x + other * self.cos, self.y - other * self.sin)),
                np.column_stack((self.x + one * self.cos, self.y - one * self.sin)),
            ],
            axis=1,
        )
        distance_m = np.hypot(self.x - self.back_x, self.y - self.back_y)
        return corners, self.may_cut & np.isfinite(corners).all(axis=(1, 2)) & (self.half > 0) & (distance_m > 1e-6)


def _lanes(table: HarvestTable, steps: Tracks) -> _Lanes:
    count = len(table)
    step = steps.step_of_row
    section = np.nan_to_num(table["section"])
    time = table["time_s"] if table.unix_time else steps.time_s[step] + 0.0
    order = np.lexsort((np.arange(count), time, np.zeros(count) if table.unix_time else table.source_of_row))
    lanes = np.lexsort((time, section, steps.stream[step]))
    heading = row_headings(table, steps)
    sin, cos = np.sin(heading), np.cos(heading)
    x, y = steps.row_x_m, steps.row_y_m
    before = np.full(count, -1, np.intp)
    before[lanes[1:]] = lanes[:-1]
    same = before >= 0
    same[same] = (
        (section[same] == section[before[same]])
        & (steps.run[step[same]] == steps.run[step[before[same]]])
        & (step[same] != step[before[same]])
    )
    distance = np.nan_to_num(table["distance_m"])
    reach = np.hypot(x - x[before], y - y[before])
    with np.errstate(invalid="ignore"):
        joined = same & (reach <= 3.0 * np.maximum(distance, 0.5)) & (np.cos(heading - heading[before]) > _MAX_EDGE_TURN)
    back_x = np.where(joined, x[before], x - distance * sin)
    back_y = np.where(joined, y[before], y - distance * cos)
    back_sin, back_cos = np.where(joined, sin[before], sin), np.where(joined, cos[before], cos)
    may_cut = steps.down[step] & ~(table["header_down"] == 0)
    return _Lanes(
        order=order,
        x=x,
        y=y,
        back_x=back_x,
        back_y=back_y,
        sin=sin,
        cos=cos,
        back_sin=back_sin,
        back_cos=back_cos,
        half=0.5 * table["width_m"],
        may_cut=may_cut,
    )


def _polygons(corners: Array) -> Shapes:
    """Quadrilaterals; one whose edges cross (a turn on the spot) as its convex hull."""
    ring = np.concatenate((corners, corners[:, :1]), axis=1)
    bad = ~np.isfinite(ring).all(axis=(1, 2))
    ring[bad] = 0.0
    shapes: Shapes = shapely.polygons(ring)
    crossing = ~bad & ~_convex(corners)
    shapes[crossing] = shapely.convex_hull(shapely.multipoints(corners[crossing]))
    thin = crossing & (shapely.get_type_id(shapes) != 3)
    shapes[bad | thin] = shapely.Polygon()
    return shapes


def _cross(a: Array, b: Array) -> Array:
    product: Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _convex(corners: Array) -> Flags:
    edges = np.roll(corners, -1, axis=1) - corners
    turns = _cross(edges, np.roll(edges, -1, axis=1))
    return np.asarray((turns > 0).all(axis=1) | (turns < 0).all(axis=1))


def _overlaps(shapes: Shapes, corners: Array, area: Array) -> tuple[Index, Index]:
    """Pairs (later, earlier) of swaths that share ground worth taking off."""
    if not len(shapes):
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    tree = shapely.STRtree(shapes)
    later, earlier = [], []
    for first in range(0, len(shapes), CHUNK):
        asked, found = tree.query(shapes[first : first + CHUNK])
        asked = asked + first
        before = found < asked
        asked, found = asked[before], found[before]
        apart = _separated(corners[asked], corners[found], area[asked])
        later.append(asked[~apart])
        earlier.append(found[~apart])
    return np.concatenate(later), np.concatenate(earlier)


def _separated(a: Array, b: Array, area: Array) -> Flags:
    """Whether an edge of either quadrilateral parts them, but for a strip that is no more than a rounding error."""
    apart = np.zeros(len(a), bool)
    left = np.arange(len(a))
    for k in (1, 3, 0, 2):
        for one, other in ((a, b), (b, a)):
            parted = _parts(one[left], other[left], k, area[left])
            apart[left[parted]] = True
            left = left[~parted]
    return apart


def _parts(one: Array, other: Array, k: int, area: Array) -> Flags:
    start = one[:, k]
    edge = one[:, (k + 1) % 4] - start
    length = np.hypot(edge[:, 0], edge[:, 1])
    side = np.sign(_cross(edge, one.mean(axis=1) - start))
    into = (_cross(edge[:, None, :], other - start[:, None, :]) * side[:, None]).max(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = np.where(length > 0, into / length, np.inf)
        extent = np.hypot(*(other.max(axis=1) - other.min(axis=1)).T)
        return np.asarray(depth * extent <= MIN_OVERLAP * area)


def _remaining(shapes: Shapes, later: Index, earlier: Index) -> tuple[Index, Shapes]:
    """Which swaths lost ground, and what is left of each."""
    if not len(later):
        return np.zeros(0, np.intp), np.zeros(0, object)
    order = np.argsort(later, kind="stable")
    later, earlier = later[order], earlier[order]
    changed, first, number = np.unique(later, return_index=True, return_counts=True)
    left: Shapes = shapes[changed].copy()
    width = np.maximum(1, 2 ** np.ceil(np.log2(number)).astype(int))
    for size in np.unique(width):
        for group in np.array_split(np.flatnonzero(width == size), max(1, int((width == size).sum() * size // (4 * CHUNK)))):
            if not len(group):
                continue
            slots = np.arange(size)[None, :]
            place = np.minimum(first[group][:, None] + slots, len(earlier) - 1)
            others: Shapes = shapes[earlier[place]]
            others[slots >= number[group][:, None]] = None
            taken = others[:, 0] if size == 1 else shapely.union_all(others, axis=1)
            left[group] = shapely.difference(shapes[changed[group]], taken)
    return changed, left
