"""Harvests whose places are an antenna's: the map is that of the places of the header."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from yieldmon.field import sources
from yieldmon.field.harvest import HarvestMap, MapOptions, make_map
from yieldmon.field.header_place import HeaderPlace
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.table import HarvestTable

from .synthetic import EARTH_M_DEG, ag_leader

AHEAD_M, RIGHT_M = 3.2, -0.8


def by_antenna(table: HarvestTable) -> HarvestTable:
    """The places of an antenna that the header is AHEAD_M ahead of, of passes to the north and to the south by turns."""
    row = np.arange(len(table))
    down = np.flatnonzero(table["header_down"] > 0)
    heading = np.interp(row, down, np.where(table["pass_number"][down] % 2 == 1, 0.0, np.pi))
    sin, cos = np.sin(heading), np.cos(heading)
    east, north = AHEAD_M * sin + RIGHT_M * cos, AHEAD_M * cos - RIGHT_M * sin
    return table.with_columns(
        latitude_deg=table["latitude_deg"] - north / EARTH_M_DEG,
        longitude_deg=table["longitude_deg"] - east / (EARTH_M_DEG * np.cos(np.radians(40.0))),
    )


@pytest.mark.parametrize("who_says", ["a person", "the source"])
def test_the_map_of_an_antenna_is_that_of_the_header(tmp_path: Path, who_says: str) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=12, seed=5)
    table = sources.read(path, ReadOptions())
    antenna = by_antenna(table)
    header = HeaderPlace(AHEAD_M, RIGHT_M)
    if who_says == "the source":
        count, header = len(table), HeaderPlace()
        antenna = antenna.with_columns(header_ahead_m=np.full(count, AHEAD_M), header_right_m=np.full(count, RIGHT_M))
    whole, found = make_map(table, MapOptions()), make_map(antenna, MapOptions(header=header))
    # The delay of the places of the antenna is shorter by the way to the header.
    assert found.flow_delay.value_s == pytest.approx(whole.flow_delay.value_s, abs=0.2)
    assert make_map(antenna, MapOptions(header=HeaderPlace(0.0, 0.0))).flow_delay.value_s < whole.flow_delay.value_s - 1.0
    assert found.totals.area_m2 == pytest.approx(whole.totals.area_m2, rel=0.005)
    inner = whole.cleaned.kept & found.cleaned.kept
    assert inner.sum() > 0.95 * whole.cleaned.kept.sum()
    # At the ends of passes a heading is also that of the turn.
    apart_m = np.abs(places_m(found) - places_m(whole))[inner].max(axis=1)
    assert np.percentile(apart_m, 97) < 0.01
    assert apart_m.max() < 0.5
    assert found.placed.mass_kg[inner] == pytest.approx(whole.placed.mass_kg[inner], rel=1e-6)


def places_m(result: HarvestMap) -> np.ndarray:
    """The middle of each row's ground, about one place."""
    corners = result.ground.corners_m.mean(axis=1)
    longitude, latitude = result.steps.plane.to_deg(corners[:, 0], corners[:, 1])
    return np.column_stack((longitude + 90.0, latitude - 40.0)) * EARTH_M_DEG
