"""Harvests whose places are the antenna's, moved to the header: where the grain was cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .plane import astray
from .table import HarvestTable
from .tracks import row_headings, tracks

FARTHEST_M = 20.0
"""From the antenna to the header's middle, in either direction, at most."""


@dataclass(frozen=True)
class HeaderPlace:
    """Where the header's middle is, seen from the antenna: m ahead of it and m to the right of it; None: as the source says."""

    ahead_m: float | None = None
    right_m: float | None = None


def at_header(table: HarvestTable, header: HeaderPlace) -> HarvestTable:
    """The table with the places of the header's middle. Where the machine heads nowhere a place stays.

    Parameters
    ----------
    table : HarvestTable
        With the antenna's places; `header_ahead_m` and `header_right_m` are from there, and 0 where they are not known.
    header : HeaderPlace
        Of all rows, in place of the table's.
    """
    ahead, right = (
        np.nan_to_num(table[name]) if given is None else np.full(len(table), given)
        for name, given in (("header_ahead_m", header.ahead_m), ("header_right_m", header.right_m))
    )
    if not (ahead.any() or right.any()):
        return table
    steps = tracks(table)
    heading = row_headings(table, steps)
    sin, cos = np.sin(heading), np.cos(heading)
    x, y = steps.row_x_m + ahead * sin + right * cos, steps.row_y_m + ahead * cos - right * sin
    known = np.isfinite(x) & np.isfinite(y) & ~astray(x)
    longitude, latitude = steps.plane.to_deg(x[known], y[known])
    places = {"longitude_deg": table["longitude_deg"].copy(), "latitude_deg": table["latitude_deg"].copy()}
    places["longitude_deg"][known], places["latitude_deg"][known] = longitude, latitude
    return table.with_columns(**places)
