"""The report: one HTML file that needs no network: map, what was left out and why, delay, passes, loads and totals."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np

from yieldmon.field.cleaning import ABOUT, KEPT, NO_PLACE
from yieldmon.field.delay import Decision
from yieldmon.field.grid import Grid, block_means
from yieldmon.field.harvest import HarvestMap
from yieldmon.field.harvest_notes import crops_of
from yieldmon.field.plane import astray, wrapped_deg
from yieldmon.field.summary import delay_lines, transport_line
from yieldmon.field.table import Array
from yieldmon.files import whole_file
from yieldmon.units import KG_PER_T, T_HA_PER_KG_M2, Units, UnitSystem

from . import FILES

TEMPLATE = Path(__file__).with_name("report.html")
MAX_POINTS = 250_000
MAX_NOTES = 40
AREA_M = 40.0
MIN_AREA_POINTS = 8
WORST = 12
_UNKNOWN = 65_535
_BINS = 40


def write(folder: Path, result: HarvestMap, grid: Grid) -> list[Path]:
    """`report.html`."""
    path = folder / FILES["report"][0]
    text = json.dumps(content(result), allow_nan=False, separators=(",", ":"))
    # Names come from files: nothing of them may end the element that holds the data.
    safe = text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    whole_file.write(path, TEMPLATE.read_text(encoding="utf-8").replace("@DATA@", safe))
    return [path]


def colour_scale(result: HarvestMap) -> tuple[float, float]:
    """Yields between which colours go, t/ha: the middle 96 % of the points kept."""
    kept = result.yield_kg_m2[result.cleaned.kept] * T_HA_PER_KG_M2
    if kept.size < 2:
        return 0.0, 1.0
    low, high = (float(value) for value in np.percentile(kept, [2, 98]))
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def content(result: HarvestMap) -> dict[str, Any]:
    """What the page shows, as JSON takes it."""
    low, high = colour_scale(result)
    totals, flow, moisture = result.totals, result.flow_delay, result.moisture_delay
    units = result.units
    shown, mass = units.yield_unit, units.mass_unit
    middle, lowest, highest = (_number(shown.of(value), 2) for value in (totals.yield_kg_m2, totals.low_kg_m2, totals.high_kg_m2))
    bushels = result.bushels_per_acre(totals.yield_kg_m2) if shown.name == "t/ha" else None
    name = " ".join(dict.fromkeys(_plain(text) for text in result.table.labels["field"].names if text)) or "Harvest"
    crops = crops_of(result.table)
    span = (
        ""
        if totals.low_kg is None or totals.high_kg is None
        else f", {_grain(totals.low_kg, units)} to {_grain(totals.high_kg, units)}"
    )
    return {
        "title": f"{', '.join((name, *filter(None, crops if len(crops) > 1 else (result.crop,))))}: yield map",
        "subtitle": "; ".join(
            f"{Path(source.path).name} ({source.kind}, {source.points} points)" for source in result.table.sources[:6]
        ),
        "numbers": [
            [
                f"{middle} {shown.name}",
                f"yield; {lowest} to {highest} by passes drawn again",
            ],
            *([[f"{_number(bushels, 1)} bu/ac", "the same in bushels"]] if bushels is not None else []),
            [_grain(totals.corrected_kg, units), f"grain{' by weighed loads' if span else ' as measured, not weighed'}{span}"],
            [units.area(totals.area_m2), "ground newly cut"],
            [" / ".join(dict.fromkeys(f"{one.flow.value_s:z.1f} s" for one in result.machines[:4])), _delay_words(result)],
            [f"{100 * result.cleaned.kept.mean() if len(result.table) else 0:.0f} %", f"of {len(result.table)} points kept"],
        ],
        "unit": {"name": shown.name, "per_t_ha": shown.of(1.0 / T_HA_PER_KG_M2), "mass": mass.name, "per_kg": mass.of(1.0)},
        "scale": [low, high],
        "points": _points(result),
        "reasons": _reasons(result),
        "histogram": _histogram(result, high),
        "delay": {
            "shift_s": flow.curve.shift_s.tolist(),
            "correlation": _list(flow.curve.correlation),
            "moisture": _list(moisture.curve.correlation),
            "value": flow.value_s,
            "low": flow.low_s,
            "high": flow.high_s,
            "declared": flow.declared_s,
            "text": f"{'. '.join(delay_lines(result))}. "
            f"Correlation {_number(flow.no_shift, 2)} with no shift, {_number(flow.shifted, 2)} shifted, "
            f"{_number(flow.held_out, 2)} on pairs held out; {flow.pairs} pairs.",
        },
        "worst": _worst(result),
        "worst_text": f"Blocks of {AREA_M:.0f} m with at least {MIN_AREA_POINTS} points, lowest yield first.",
        "loads": [load.document() for load in result.loads if load.measured_kg > 0],
        "totals": _totals(result),
        "notes": _notes(result),
    }


def _delay_words(result: HarvestMap) -> str:
    flow = result.flow_delay
    if len({machine.flow.value_s for machine in result.machines}) > 1:
        return f"delays of {len(result.machines)} machines or files"
    if flow.decision is Decision.ESTIMATED:
        return f"delay; {flow.low_s:.1f} to {flow.high_s:.1f}"
    return "delay, as given" if flow.decision is Decision.DECLARED else "delay: not determined by the data, default"


def _plain(text: str) -> str:
    return text.split(":", 1)[1].strip() or text if ":" in text else text


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None or not np.isfinite(value) else f"{value:.{digits}f}"


def _list(values: Array) -> list[float | None]:
    return [round(float(value), 4) if np.isfinite(value) else None for value in values]


def _points(result: HarvestMap) -> dict[str, Any]:
    steps = result.steps
    known = np.flatnonzero(np.isfinite(steps.row_x_m) & ~astray(steps.row_x_m))
    known = known[np.lexsort((result.table["time_s"][known], result.table.source_of_row[known]))]
    every = max(1, -(-len(known) // MAX_POINTS))
    rows = known[::every]
    x, y = steps.row_x_m[rows], steps.row_y_m[rows]
    kept = result.cleaned.kept[rows]
    chosen = (x[kept], y[kept]) if kept.any() else (x, y)
    bounds = [float(f(one)) if one.size else 0.0 for f in (np.min, np.max) for one in chosen]
    highest = max(
        float(np.nanpercentile(result.raw_yield_kg_m2, 99.9)) if np.isfinite(result.raw_yield_kg_m2).any() else 1.0, 0.1
    )
    step = highest * T_HA_PER_KG_M2 * 1.5 / (_UNKNOWN - 1)
    gross = result.ground.gross_m2[result.ground.gross_m2 > 0]
    return {
        "x": _packed(x.astype("<f4")),
        "y": _packed(y.astype("<f4")),
        "raw": _levels(result.raw_yield_kg_m2[rows], step),
        "clean": _levels(result.yield_kg_m2[rows], step),
        "reason": _packed(result.cleaned.reason[rows].astype("u1")),
        "pass": _packed((steps.pass_number[steps.step_of_row[rows]] + 1).astype("<i4")),
        "step_t_ha": step,
        "bounds": bounds,
        "spacing_m": float(np.sqrt(np.median(gross))) * np.sqrt(every) if gross.size else 3.0,
        "thinned": "" if every == 1 else f"Every {every}th of {len(known)} points is drawn; tables and totals include all.",
    }


def _packed(values: np.ndarray) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")


def _levels(values_kg_m2: Array, step: float) -> str:
    level = np.clip(np.round(values_kg_m2 * T_HA_PER_KG_M2 / step), 0, _UNKNOWN - 1)
    return _packed(np.where(np.isfinite(level), level, _UNKNOWN).astype("<u2"))


def _reasons(result: HarvestMap) -> list[dict[str, Any]]:
    counts = np.bincount(result.cleaned.reason, minlength=len(result.cleaned.names))
    mass, whole = result.totals.by_reason, max(result.totals.corrected_kg, 1e-9)
    rows = [
        {
            "name": name,
            "about": ABOUT.get(name, ""),
            "points": int(counts[k]),
            "kg": round(mass.get(name, 0.0), 1),
            "share_pct": 100.0 * mass.get(name, 0.0) / whole,
        }
        for k, name in enumerate(result.cleaned.names)
    ]
    lost = mass.get(NO_PLACE, 0.0)
    if lost:
        rows.append(
            {"name": NO_PLACE, "about": ABOUT[NO_PLACE], "points": 0, "kg": round(lost, 1), "share_pct": 100.0 * lost / whole}
        )
    return rows


def _histogram(result: HarvestMap, high: float) -> dict[str, Any]:
    top = 1.5 * high
    down = result.steps.down[result.steps.step_of_row]
    raw = result.raw_yield_kg_m2[down] * T_HA_PER_KG_M2
    clean = result.yield_kg_m2[result.cleaned.kept] * T_HA_PER_KG_M2
    counts = [np.histogram(values[np.isfinite(values)], _BINS, (0.0, top))[0].tolist() for values in (raw, clean)]
    return {"low": 0.0, "high": top, "raw": counts[0], "clean": counts[1]}


def _worst(result: HarvestMap) -> list[dict[str, Any]]:
    table = result.table
    grid = block_means(
        table["longitude_deg"], table["latitude_deg"], result.placed.mass_kg, result.ground.area_m2, result.cleaned.kept, AREA_M
    )
    rows = np.flatnonzero(grid.points >= MIN_AREA_POINTS)
    rows = rows[np.argsort(grid.yield_kg_m2[rows])][:WORST]
    longitude, latitude = grid.middle_deg()
    longitude = wrapped_deg(longitude)
    x, y = result.steps.plane.to_m(longitude, latitude)
    return [
        {
            "name": f"{latitude[k]:.5f}, {longitude[k]:.5f}",
            "x": float(x[k]),
            "y": float(y[k]),
            "size_m": AREA_M,
            "yield_t_ha": float(grid.yield_kg_m2[k] * T_HA_PER_KG_M2),
            "standard_error_t_ha": float(grid.standard_error_kg_m2[k] * T_HA_PER_KG_M2),
            "of_mean_pct": float(100.0 * grid.yield_kg_m2[k] / result.totals.yield_kg_m2),
            "left_out_pct": float(100.0 * grid.left_out[k]),
        }
        for k in rows
    ]


def _grain(kg: float, units: Units) -> str:
    """Grain of a field: tonnes, or pounds."""
    return f"{kg / KG_PER_T:.1f} t" if units.system is UnitSystem.METRIC else units.mass(kg)


def _totals(result: HarvestMap) -> list[list[str]]:
    totals, units = result.totals, result.units

    def mass(kg: float) -> str:
        return f"{units.mass_unit.of(kg):,.0f}"

    rows = [["measured, all points", mass(totals.measured_kg), ""]]
    if totals.machine_kg is not None:
        rows.append(["the machine's own total", mass(totals.machine_kg), ""])
    if totals.low_kg is not None and totals.high_kg is not None:
        rows.append([f"by weighed loads ({mass(totals.low_kg)} to {mass(totals.high_kg)})", mass(totals.corrected_kg), ""])
    kept = totals.by_reason.get(KEPT, 0.0)
    rows.append(["on the points kept", mass(kept), _number(units.yield_unit.of(totals.yield_kg_m2), 2)])
    rows.append(["left out, with reasons", mass(totals.corrected_kg - kept), ""])
    rows.append([f"ground cut {units.area(totals.area_m2)}, kept {units.area(totals.kept_area_m2)}", "", ""])
    return rows


def _notes(result: HarvestMap) -> list[list[Any]]:
    notes: list[list[Any]] = [[note, True] for note in result.notes]
    if result.transport is not None:
        notes.append([transport_line(result.transport), False])
    for source in result.table.sources:
        notes += [[f"{source.path}: {one.part}: {one.why}; left out", True] for one in source.skipped]
        notes += [[f"{source.path}: {note}", False] for note in source.notes]
    if len(notes) > MAX_NOTES:
        notes = [*notes[:MAX_NOTES], [f"and {len(notes) - MAX_NOTES} more", False]]
    notes.append(
        ["Blocks, swaths and all points with their reasons are in harvest.gpkg and points.csv in the same folder.", False]
    )
    return notes
