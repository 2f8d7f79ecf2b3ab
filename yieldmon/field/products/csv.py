"""All points with their reasons as CSV: what is not known is an empty field."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.field.grid import Grid
from yieldmon.field.harvest import HarvestMap
from yieldmon.files.whole_file import scratch_for

from . import FILES
from .columns import point_columns

CHUNK = 50_000
_DECIMALS = {"longitude_deg": 8, "latitude_deg": 8, "time_s": 3}


def write(folder: Path, result: HarvestMap, grid: Grid) -> list[Path]:
    """`points.csv`."""
    path = folder / FILES["csv"][0]
    with scratch_for(path) as scratch, scratch.open("w", encoding="utf-8", newline="") as stream:
        for first in range(0, max(len(result.table), 1), CHUNK):
            rows = np.arange(first, min(first + CHUNK, len(result.table)))
            columns = {
                "longitude_deg": result.table["longitude_deg"][rows],
                "latitude_deg": result.table["latitude_deg"][rows],
                **point_columns(result, rows),
            }
            if not first:
                stream.write(",".join(map(_text, columns)) + "\n")
            stream.writelines(_lines(columns))
    return [path]


def _lines(columns: dict[str, NDArray[Any]]) -> Iterator[str]:
    texts = [_cells(name, values) for name, values in columns.items()]
    return (",".join(row) + "\n" for row in zip(*texts, strict=True))


def _cells(name: str, values: NDArray[Any]) -> list[str]:
    if values.dtype == object:
        known = {text: _text(str(text)) for text in set(values.tolist())}
        return [known[text] for text in values.tolist()]
    if np.issubdtype(values.dtype, np.datetime64):
        return [f"{one}Z" if one != "NaT" else "" for one in np.datetime_as_string(values, unit="ms").tolist()]
    if values.dtype == bool:
        return ["1" if one else "0" for one in values.tolist()]
    if np.issubdtype(values.dtype, np.integer):
        return [str(one) for one in values.tolist()]
    decimals = _DECIMALS.get(name)
    rounded = values.astype(float).tolist()
    if decimals is not None:
        return [f"{one:.{decimals}f}" if one == one else "" for one in rounded]  # noqa: PLR0124
    return [f"{one:.7g}" if one == one else "" for one in rounded]  # noqa: PLR0124


def _text(text: str) -> str:
    # A spreadsheet takes a leading sign of these for a formula.
    safe = f"'{text}" if text[:1] in ("=", "+", "-", "@") else text
    return '"' + safe.replace('"', '""') + '"' if any(mark in safe for mark in ',"\n\r') else safe
