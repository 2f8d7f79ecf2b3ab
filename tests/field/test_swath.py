"""Ground newly cut by each point against polygons drawn in the test."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from shapely.geometry import Polygon
from shapely.ops import unary_union

from yieldmon.field.header_place import HeaderPlace, at_header
from yieldmon.field.swath import swaths
from yieldmon.field.table import HarvestTable, Label, Source, build
from yieldmon.field.tracks import tracks

EARTH_M_DEG = 111_195.0
WIDTH_M, STEP_M = 6.0, 2.0


@dataclass
class Drive:
    """A straight pass from one place to another, m, with a width; header down."""

    start: tuple[float, float]
    end: tuple[float, float]
    width_m: float = WIDTH_M


def table_of(
    drives: list[Drive], latitude: float, longitude: float, step_m: float = STEP_M
) -> tuple[HarvestTable, list[Polygon]]:
    """Points at the end of each step, 1 s apart, 30 s between passes; and the rectangle that each of them cut."""
    rows, shapes, time = [], [], 0.0
    for drive in drives:
        a, b = np.array(drive.start), np.array(drive.end)
        way = b - a
        length = float(np.hypot(*way))
        ahead = way / length
        side = np.array([ahead[1], -ahead[0]]) * drive.width_m / 2
        for k in range(1, round(length / step_m) + 1):
            here, before = a + ahead * step_m * k, a + ahead * step_m * (k - 1)
            rows.append((time, *here, drive.width_m))
            shapes.append(Polygon([before - side, before + side, here + side, here - side]))
            time += 1.0
        time += 30.0
    time_s, east, north, width = np.array(rows).T
    # Metres on the ellipsoid near a place, by the radii of curvature there.
    e2, radius = 0.00669437999014, 6_378_137.0
    sin = np.sin(np.radians(latitude))
    prime = radius / np.sqrt(1 - e2 * sin**2)
    meridian = radius * (1 - e2) / np.sqrt(1 - e2 * sin**2) ** 3
    lat = latitude + np.degrees(north / meridian)
    lon = longitude + np.degrees(east / (prime * np.cos(np.radians(lat))))
    count = len(rows)
    columns = {
        "time_s": time_s,
        "longitude_deg": (lon + 180) % 360 - 180,
        "latitude_deg": lat,
        "flow_kg_s": np.ones(count),
        "interval_s": np.ones(count),
        "distance_m": np.full(count, step_m),
        "width_m": width,
        "header_down": np.ones(count),
    }
    return build(columns, {}, Source("drawn", "test", count), unix_time=False), shapes


def newly_cut(shapes: list[Polygon]) -> np.ndarray:
    """By the definition: each less all before it."""
    cut = Polygon()
    areas = []
    for shape in shapes:
        areas.append(shape.difference(cut).area)
        cut = unary_union([cut, shape])
    return np.array(areas)


LAND = [Drive((k * WIDTH_M, 3 if k % 2 == 0 else 117), (k * WIDTH_M, 117 if k % 2 == 0 else 3)) for k in range(8)]
FIELDS = {
    "abutting passes": LAND,
    "headlands first": [Drive((-3, 0), (45, 0)), Drive((-3, 120), (45, 120)), *LAND],
    "point rows": [Drive((-10, 10), (60, 90)), *LAND],
    "half-width passes": [Drive((k * 3.0, 0 if k % 2 == 0 else 100), (k * 3.0, 100 if k % 2 == 0 else 0)) for k in range(9)],
    "a narrow finish": [*LAND[:3], Drive((14.5, 3), (14.5, 117)), Drive((25.5, 117), (25.5, 3)), Drive((20.0, 3), (20.0, 117))],
    "the same ground three times": [Drive((0, 0), (0, 60)), Drive((1, 60), (1, 0)), Drive((0, 0), (0, 60))],
    "narrow sections": [Drive((k * 1.5, 0), (k * 1.5, 80), 1.5) for k in range(6)],
}


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("where", [(40.0, -90.0), (-34.0, 150.0), (57.0, 0.0)])
def test_area_of_each_point(name: str, where: tuple[float, float]) -> None:
    table, shapes = table_of(FIELDS[name], *where)
    found = swaths(table, tracks(table))
    expected = newly_cut(shapes)
    gross = np.array([shape.area for shape in shapes])
    assert np.abs(found.area_m2 - expected).max() < 0.01 * gross.max()
    assert found.area_m2.sum() == pytest.approx(expected.sum(), rel=0.002)
    assert found.gross_m2 == pytest.approx(gross, rel=0.01)


def test_a_field_across_two_zones_and_the_date_line_has_the_same_area() -> None:
    areas = []
    for longitude in (-90.0, 0.0, 6.0, 179.9997, -180.0):
        table, _ = table_of(FIELDS["headlands first"], 45.0, longitude)
        areas.append(swaths(table, tracks(table)).area_m2.sum())
    assert areas == pytest.approx([areas[0]] * len(areas), rel=1e-6)


def test_header_offset_moves_the_ground() -> None:
    table, _ = table_of([Drive((0, 0), (0, 100))], 40.0, -90.0)
    plane = tracks(table).plane

    def corners_m(header: HeaderPlace) -> np.ndarray:
        moved = at_header(table, header)
        steps = tracks(moved)
        return np.column_stack(plane.to_m(*steps.plane.to_deg(*swaths(moved, steps).corners_m[10].T)))

    plain = corners_m(HeaderPlace())
    for header, expected in ((HeaderPlace(4.0, 0.0), [0.0, 4.0]), (HeaderPlace(0.0, 1.5), [1.5, 0.0])):
        assert corners_m(header) - plain == pytest.approx(np.tile(expected, (4, 1)), abs=1e-3)


@pytest.mark.parametrize(
    ("right_m", "from_m", "to_m"),
    [
        # By its width alone: where the header is not over ground that was cut.
        (np.nan, 9.0, 12.0),
        # By its sections: the right half, and the left one over ground that was cut.
        (1.5, 9.0, 12.0),
        (-1.5, 9.0, 9.0),
    ],
)
def test_a_part_of_the_header_cuts_at_its_side(right_m: float, from_m: float, to_m: float) -> None:
    """Half a header of 6 m, driven along the edge of ground that was cut; in its middle it would lose half of its ground."""
    table, _ = table_of([Drive((0, 0), (0, 100)), Drive((6, 100), (6, 0)), Drive((9, 0), (9, 100), 3.0)], 40.0, -90.0)
    last = np.arange(100, 150)
    found = swaths(table.with_columns(cut_right_m=np.where(np.isin(np.arange(150), last), right_m, np.nan)), tracks(table))
    assert found.gross_m2[last] == pytest.approx(np.full(50, 3.0 * STEP_M), rel=1e-3)
    assert found.area_m2[last] == pytest.approx(np.full(50, (to_m - from_m) * STEP_M), rel=2e-3, abs=0.02)
    if to_m > from_m:
        west, _, east, _ = unary_union(found.polygons(last)).bounds
        first, _, _, _ = found.polygons(np.array([10]))[0].bounds
        assert (west - first, east - first) == pytest.approx((from_m + 3.0, to_m + 3.0), abs=0.02)


def test_a_narrower_header_of_another_field_is_no_part_of_a_wider_one() -> None:
    """Passes of 3 m that overlap by 0.6 m, and those of 6 m of another field."""
    drives = [
        *(Drive((2.4 * k, 0), (2.4 * k, 100), 3.0) for k in range(4)),
        *(Drive((500 + 6 * k, 0), (500 + 6 * k, 100)) for k in range(4)),
    ]
    table, _ = table_of(drives, 40.0, -90.0)
    fields = Label.of(["south"] * 200 + ["north"] * 200)
    found = swaths(replace(table, labels={**table.labels, "field": fields}), tracks(table))
    assert found.area_m2.sum() == pytest.approx(100 * (3.0 + 3 * 2.4 + 4 * 6.0), rel=1e-3)


def test_a_strip_between_cut_ground_is_in_the_middle_of_the_header() -> None:
    drives = [Drive((0, 0), (0, 100)), Drive((9, 100), (9, 0)), Drive((4.5, 0), (4.5, 100), 3.0)]
    table, _ = table_of(drives, 40.0, -90.0)
    assert swaths(table, tracks(table)).area_m2.sum() == pytest.approx(100 * 15.0, rel=1e-3)


def test_header_up_cuts_nothing() -> None:
    table, _ = table_of([Drive((0, 0), (0, 100))], 40.0, -90.0)
    down = np.ones(len(table))
    down[10:20] = 0
    found = swaths(table.with_columns(header_down=down), tracks(table.with_columns(header_down=down)))
    assert (found.area_m2[10:20] == 0).all()
    assert found.area_m2.sum() == pytest.approx(40 * 12.0, rel=1e-3)
    shapes = found.polygons(np.arange(len(table)))
    assert all(shape.is_empty for shape in shapes[10:20])
