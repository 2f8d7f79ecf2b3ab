"""Places as texts: degrees with letters, minutes and seconds, and points as well-known text."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from .naming import plain_name

_NUMBER = r"(\d+(?:[.,]\d+)?)"
_DEGREES = re.compile(
    rf"\s*([NSEW])?\s*([+-]?){_NUMBER}\s*(°|º|deg)?\s*(?:{_NUMBER}\s*['′’]\s*)?(?:{_NUMBER}\s*(?:\"|″|”|''))?\s*([NSEW])?\s*",
    re.IGNORECASE,
)
_COORDINATE = r"(-?[\d.]+(?:e[+-]?\d+)?)"
_POINT = re.compile(rf"\s*(?:SRID=\d+;)?\s*POINT\s*(?:Z|M|ZM)?\s*\(\s*{_COORDINATE}\s+{_COORDINATE}[^()]*\)\s*", re.IGNORECASE)
_SHAPES = ("wkt", "wktgeom", "geom", "geometry", "thegeom", "shape", "point")
"""Names of columns of shapes."""


def degrees(text: str) -> str:
    """A place's degrees as a number; any other text as it is.

    >>> degrees("33.5 S"), degrees("W 93°30'36\\""), degrees("10.25"), degrees("n/a")
    ('-33.5', '-93.51', '10.25', 'n/a')
    """
    found = _DEGREES.fullmatch(text)
    if found is None or not (found[1] or found[4] or found[7]) or (found[1] and found[7]):
        return text
    whole, minutes, seconds = (float((found[place] or "0").replace(",", ".")) for place in (3, 5, 6))
    if minutes > 60.0 or seconds > 60.0:
        return text
    below = -1 if found[2] == "-" or (found[1] or found[7] or "").upper() in ("S", "W") else 1
    return f"{below * (whole + minutes / 60.0 + seconds / 3600.0):.10g}"


def column_of_points(names: Sequence[str], sample: Sequence[Sequence[str]]) -> int | None:
    """Number of the column of points as well-known text; None where there is none."""
    for number, name in enumerate(names):
        if plain_name(name) in _SHAPES and any(_POINT.fullmatch(row[number]) for row in sample if number < len(row)):
            return number
    return None


def with_coordinates(rows: Iterator[tuple[int, list[str]]], column: int, width: int) -> Iterator[tuple[int, list[str]]]:
    """Rows of a width with x and y of the points in a column behind them; empty where a row has no point."""
    for line, row in rows:
        found = _POINT.fullmatch(row[column]) if column < len(row) else None
        yield line, [*row[:width], *[""] * (width - len(row)), *(found.group(1, 2) if found else ("", ""))]


def with_degrees(rows: Iterator[tuple[int, list[str]]], columns: Sequence[int]) -> Iterator[tuple[int, list[str]]]:
    """Rows with the degrees in some columns as numbers."""
    for line, row in rows:
        for column in columns:
            if column < len(row):
                row[column] = degrees(row[column])
        yield line, row
