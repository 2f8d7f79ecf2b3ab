"""Yield points as Ag Leader "advanced" text, which yield-cleaning tools such as the USDA's Yield Editor read.

No header, comma-separated, 17 columns: longitude and latitude in deg, grain flow in lb/s, GPS time in s, logging interval in s,
distance and swath in inches, moisture in %, header and marker status (33 down), pass, serial number, field ("F<number>:<name>"),
load ("L<number>:<name>"), grain, GPS status, PDOP, elevation in feet.

Sources: the order of the columns, Ag Leader Technology, "GPS 2000/2100 Operator's Manual" (April 1998), page 8-7, "Advanced Ag
Leader Format"; the units, the data set gartner.corn of the R package agridat, which gives them with the formula for the yield.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from yieldmon.files import whole_file
from yieldmon.files.plain_text import quotable
from yieldmon.files.whole_seconds import whole_seconds
from yieldmon.units import KG_PER_LB, M_PER_IN

from .points import YieldPoint

LB_PER_KG = 1.0 / KG_PER_LB
IN_PER_M = 1.0 / M_PER_IN
HEADER_DOWN = 33
NO_LOAD = 0
"""Number for grain between loads, whose numbers begin at 1."""
_DIFFERENTIAL_FIX, _PDOP, _ALTITUDE_FT = 1, 0.0, 0.0


def line(point: YieldPoint, time_s: int, field: str, grain: str) -> str:
    """One point. time_s: its time in whole seconds. A moisture that is not known is 0, as these tools expect; position quality is
    not known to yieldmon either.

    The format knows no way to write a double quote within a name: it becomes a single one.
    """
    values = (
        f"{point.longitude_deg:.7f}",
        f"{point.latitude_deg:.7f}",
        f"{point.mass_flow_kg_s * LB_PER_KG:.3f}",
        f"{time_s}",
        f"{point.duration_s:.4g}",
        f"{point.distance_m * IN_PER_M:.1f}",
        f"{point.swath_m * IN_PER_M:.2f}",
        f"{0.0 if point.moisture_pct is None else point.moisture_pct:.1f}",
        f"{HEADER_DOWN}",
        f"{point.pass_number}",
        "0",
        f'"F1:{quotable(field)}"',
        f'"L{point.load_number or NO_LOAD}:<1>"',
        f'"{quotable(grain)}"',
        f"{_DIFFERENTIAL_FIX}",
        f"{_PDOP:.1f}",
        f"{_ALTITUDE_FT:.1f}",
    )
    return ",".join(values)


def write(path: Path, points: Sequence[YieldPoint], names_of: Callable[[int | None], tuple[str, str]]) -> None:
    """One line a point. names_of: field and grain of a load, by its number; None for grain between loads."""
    times = whole_seconds(np.array([point.time_s for point in points])).tolist()
    lines = (line(point, at, *names_of(point.load_number)) for point, at in zip(points, times, strict=True))
    text = "".join(f"{one}\r\n" for one in lines)
    whole_file.write(path, text.encode("ascii", "replace"))
