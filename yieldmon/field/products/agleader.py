"""Ag Leader advanced text, twice: `agleader_raw.txt` as measured, with no delay taken out, for Yield Editor and the like, and
`agleader_clean.txt`, the points kept with their grain at its place.

Columns and units as in the reader of this format; one row a second and machine. The cleaned text has one more, the last: that
the delay was taken out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from yieldmon.field.grid import Grid
from yieldmon.field.harvest import HarvestMap
from yieldmon.field.sources.agleader import taken_out
from yieldmon.field.table import Array, Index
from yieldmon.files.plain_text import quotable
from yieldmon.files.whole_file import scratch_for
from yieldmon.units import KG_PER_LB, M_PER_FT, M_PER_IN

from . import FILES
from .text_rows import text_rows

CHUNK = 50_000
DOWN, UP = 33, 32


def write(folder: Path, result: HarvestMap, grid: Grid) -> list[Path]:
    """Both files."""
    table, steps = result.table, result.steps
    everything = np.flatnonzero(np.isfinite(table["longitude_deg"]) & np.isfinite(table["time_s"]))
    down = steps.down[steps.step_of_row]
    raw, clean = (folder / name for name in FILES["agleader"])
    _write(raw, result, everything, flow=table["flow_kg_s"], moisture=table["moisture_pct"], down=down)
    kept = np.flatnonzero(result.cleaned.kept)
    with np.errstate(invalid="ignore", divide="ignore"):
        flow = result.placed.mass_kg / table["interval_s"]
        # Readers take the yield from flow, distance and swath: the swath is the width newly cut.
        width = np.where(
            result.ground.gross_m2 > 0, table["width_m"] * result.ground.area_m2 / result.ground.gross_m2, table["width_m"]
        )
    marks = np.empty(len(table), dtype=object)
    for machine in result.machines:
        marks[machine.rows] = f',"{taken_out(machine.flow.value_s)}"'
    _write(clean, result, kept, flow=flow, moisture=result.placed.moisture_pct, down=down, width=width, marks=marks)
    return [raw, clean]


def _write(
    path: Path,
    result: HarvestMap,
    rows: Index,
    *,
    flow: Array,
    moisture: Array,
    down: np.ndarray,
    width: Array | None = None,
    marks: np.ndarray | None = None,
) -> None:
    table = result.table
    found = text_rows(result, rows, flow=flow, moisture=moisture, width=table["width_m"] if width is None else width)
    names = {name: [_name(text) for text in table.labels[name].names] for name in ("field", "load", "crop", "product")}
    serial = [_serial(text) for text in table.labels["machine"].names]
    passes = result.steps.pass_number[result.steps.step_of_row]
    # With the header up a row belongs to the pass before it.
    passes = np.maximum.accumulate(passes) + 1 if len(passes) else passes
    with scratch_for(path) as scratch, scratch.open("w", encoding="ascii", errors="replace", newline="") as stream:
        for first in range(0, len(found.row), CHUNK):
            here = slice(first, first + CHUNK)
            part = found.row[here]
            fields = zip(
                found.longitude_deg[here].tolist(),
                found.latitude_deg[here].tolist(),
                (found.flow_kg_s[here] / KG_PER_LB).tolist(),
                found.time_s[here].tolist(),
                found.interval_s[here].tolist(),
                (found.distance_m[here] / M_PER_IN).tolist(),
                (found.width_m[here] / M_PER_IN).tolist(),
                found.moisture_pct[here].tolist(),
                np.where(down[part], DOWN, UP).tolist(),
                passes[part].tolist(),
                table.labels["machine"].codes[part].tolist(),
                table.labels["field"].codes[part].tolist(),
                table.labels["load"].codes[part].tolist(),
                table.labels["crop"].codes[part].tolist(),
                (found.elevation_m[here] / M_PER_FT).tolist(),
                [""] * len(part) if marks is None else marks[part].tolist(),
                strict=True,
            )
            stream.writelines(
                f"{x:.8f},{y:.8f},{f:.3f},{t},{i:.4g},{d:.2f},{w:.1f},{m:.2f},{h},{p},{serial[s]},"
                f'"F{a + 1}:{names["field"][a]}","L{b + 1}:{names["load"][b]}","{names["crop"][c]}",1,0.0,{e:.1f}{mark}\r\n'
                for x, y, f, t, i, d, w, m, h, p, s, a, b, c, e, mark in fields
            )


def _serial(text: str) -> str:
    return text if text.isascii() and text.isdigit() else "0"


def _name(text: str) -> str:
    """A field's or load's name without the number that this format puts before it."""
    return quotable(text.split(":", 1)[1] if text[:1] in "FL" and text[1:2].isdigit() and ":" in text else text)
