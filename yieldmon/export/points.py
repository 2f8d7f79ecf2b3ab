"""Yield points: each second's grain put back where it was cut.

Grain that is measured at a time was cut `flow_delay_s` before: the position of then goes with the flow of now. In the first
seconds of a pass the machine fills and in the last ones it empties, so the flow is not that of the place: those points are left
out (start and end pass delay). See Blackmore and Marshall, "Yield mapping: errors and algorithms", 1996; Sudduth and Drummond,
"Yield Editor", Agronomy Journal 99, 2007.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from yieldmon.engine.mass.totals import dry_mass
from yieldmon.engine.settings import TotalsSettings
from yieldmon.errors import InputError
from yieldmon.frames import EstimateQuality
from yieldmon.service.storage.load_ends import load_of
from yieldmon.service.storage.rows import SecondRow

_NAN = float("nan")
_HALF_S = 0.5 + 1e-6
"""Of a row's second, and what floats of Unix time are off by."""


@dataclass(frozen=True)
class PointSettings:
    """swath_m: working width. pass_gap_s: a pause of the position's flow this long ends a pass. min_speed_m_s: below it the yield
    of a place is not defined. reference_moisture_pct: of dry mass; reference_by_load: of the loads whose crop is known.
    between_loads: numbers of the seconds that belong to no load."""

    swath_m: float
    flow_delay_s: float = 12.0
    start_pass_delay_s: float = 4.0
    end_pass_delay_s: float = 4.0
    pass_gap_s: float = 2.5
    min_speed_m_s: float = 0.3
    reference_moisture_pct: float = 15.5
    reference_by_load: Mapping[int, float] = field(default_factory=dict)
    between_loads: frozenset[int] = frozenset()

    def reference_of(self, load_number: int | None) -> float:
        """Moisture of a load's dry mass, %; of grain between loads where these have one and the same."""
        if load_number is not None:
            return self.reference_by_load.get(load_number, self.reference_moisture_pct)
        of_all = set(self.reference_by_load.values())
        return of_all.pop() if len(of_all) == 1 else self.reference_moisture_pct


@dataclass(frozen=True, slots=True)
class YieldPoint:
    """A place and the grain from it. time_s: when the machine was there (Unix time). yield_kg_m2 is wet; dry values are at the
    reference moisture, None with moisture unknown. load_number: None for grain between loads. held: the plate was in a sweep, the
    flow is a good deal less sure."""

    time_s: float
    latitude_deg: float
    longitude_deg: float
    course_deg: float | None
    ground_speed_m_s: float
    duration_s: float
    distance_m: float
    swath_m: float
    mass_flow_kg_s: float
    mass_kg: float
    total_kg: float
    moisture_pct: float | None
    yield_kg_m2: float
    dry_mass_flow_kg_s: float | None
    dry_yield_kg_m2: float | None
    load_number: int | None
    pass_number: int
    held: bool


def yield_points(rows: Sequence[SecondRow], settings: PointSettings, where: str = "record") -> list[YieldPoint]:
    """The points of a record, in its order. Raises InputError when no second has both a position and a ground speed."""
    placed = sorted(
        (row for row in rows if row.latitude_deg is not None and row.ground_speed_m_s is not None), key=lambda row: row.time_s
    )
    if not placed:
        expected = "VehiclePosition and VehicleDirectionSpeed frames"
        raise InputError(where, "has no second with position and ground speed", expected)
    times_s = [row.time_s for row in placed]
    matched = []
    for row in rows:
        place = _nearest(placed, times_s, row.time_s - settings.flow_delay_s)
        if place is None or row.mass_flow_kg_s is None or row.quality == EstimateQuality.NOT_HARVESTING:
            continue
        if (place.ground_speed_m_s or 0.0) >= settings.min_speed_m_s:
            matched.append((place, row))
    points = []
    for number, driven in enumerate(_passes(matched, settings.pass_gap_s), 1):
        first_s, last_s = driven[0][0].time_s, driven[-1][0].time_s
        for place, row in driven:
            if place.time_s - first_s < settings.start_pass_delay_s or last_s - place.time_s < settings.end_pass_delay_s:
                continue
            points.append(_point(place, row, settings, number))
    return points


def _nearest(placed: Sequence[SecondRow], times_s: Sequence[float], time_s: float) -> SecondRow | None:
    """The row whose time is nearest, the earlier of two; None where none is within half a second."""
    near = placed[bisect_left(times_s, time_s - _HALF_S) : bisect_right(times_s, time_s + _HALF_S)]
    return min(near, key=lambda row: abs(row.time_s - time_s), default=None)


def _passes(matched: Sequence[tuple[SecondRow, SecondRow]], gap_s: float) -> Iterator[list[tuple[SecondRow, SecondRow]]]:
    if not matched:
        return
    current = [matched[0]]
    for before, now in pairwise(matched):
        # A clock that is set back ends a pass as well.
        if abs(now[0].time_s - before[0].time_s) > gap_s:
            yield current
            current = []
        current.append(now)
    yield current


def _point(place: SecondRow, row: SecondRow, settings: PointSettings, number: int) -> YieldPoint:
    assert place.latitude_deg is not None, "the caller chose places"
    assert place.longitude_deg is not None, "a latitude never comes alone"
    assert place.ground_speed_m_s is not None, "the caller chose places"
    distance = place.ground_speed_m_s * row.duration_s
    area = distance * settings.swath_m
    load_number = load_of(row, settings.between_loads)
    totals = TotalsSettings(moisture_reference_pct=settings.reference_of(load_number))
    dry = dry_mass(row.mass_kg, _NAN if row.moisture_pct is None else row.moisture_pct, totals)
    return YieldPoint(
        time_s=place.time_s,
        latitude_deg=place.latitude_deg,
        longitude_deg=place.longitude_deg,
        course_deg=place.course_deg,
        ground_speed_m_s=place.ground_speed_m_s,
        duration_s=row.duration_s,
        distance_m=distance,
        swath_m=settings.swath_m,
        mass_flow_kg_s=row.mass_kg / row.duration_s,
        mass_kg=row.mass_kg,
        total_kg=row.total_kg,
        moisture_pct=row.moisture_pct,
        yield_kg_m2=row.mass_kg / area,
        dry_mass_flow_kg_s=None if dry is None else dry / row.duration_s,
        dry_yield_kg_m2=None if dry is None else dry / area,
        load_number=load_number,
        pass_number=number,
        held=row.quality == EstimateQuality.SWEEPING,
    )
