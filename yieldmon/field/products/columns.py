"""The columns of a map's points, once for all formats."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.field.harvest import HarvestMap
from yieldmon.field.row_crops import row_bushels_kg
from yieldmon.field.table import LABELS, Index
from yieldmon.units import M2_PER_ACRE, T_HA_PER_KG_M2

SHORT_NAMES: Mapping[str, str] = {
    "point": "POINT",
    "time_s": "TIME_S",
    "time_utc": "TIMEUTC",
    "field": "FIELD",
    "load": "LOAD",
    "crop": "CROP",
    "pass_number": "PASS",
    "interval_s": "INTERV_S",
    "distance_m": "DIST_M",
    "width_m": "WIDTH_M",
    "area_m2": "AREA_M2",
    "mass_kg": "MASS_KG",
    "mass_flow_kg_s": "FLOW_KG_S",
    "moisture_pct": "MOIST_PCT",
    "yield_t_ha": "YLD_T_HA",
    "yield_bu_ac": "YLD_BU_AC",
    "elevation_m": "ELEV_M",
}
"""Ten letters at most, as a shapefile's table takes them."""


def point_columns(result: HarvestMap, rows: Index) -> dict[str, NDArray[Any]]:
    """Columns of some rows; `time_utc` only where the source's clock has a date, `yield_bu_ac` where a crop's bushel is known."""
    table, steps, placed, ground = result.table, result.steps, result.placed, result.ground
    step = steps.step_of_row[rows]
    amount = result.yield_kg_m2[rows]
    interval = table["interval_s"][rows]
    with np.errstate(invalid="ignore", divide="ignore"):
        flow = np.where(interval > 0, placed.mass_kg[rows] / interval, np.nan)
    out: dict[str, NDArray[Any]] = {"point": rows + 1}
    if table.unix_time:
        out["time_utc"] = unix_to_datetime(table["time_s"][rows])
    out["time_s"] = table["time_s"][rows]
    for name in LABELS:
        label = table.labels[name]
        if any(label.names):
            out[name] = label.take(rows).text()
    out |= {
        "pass_number": steps.pass_number[step] + 1,
        "heading_deg": np.degrees(steps.heading_rad[step]) % 360.0,
        "speed_m_s": steps.speed_m_s[step],
        "interval_s": interval,
        "distance_m": table["distance_m"][rows],
        "width_m": table["width_m"][rows],
        "area_m2": ground.area_m2[rows],
        "gross_area_m2": ground.gross_m2[rows],
        "mass_kg": placed.mass_kg[rows],
        "mass_flow_kg_s": flow,
        "moisture_pct": placed.moisture_pct[rows],
        "yield_t_ha": amount * T_HA_PER_KG_M2,
    }
    if np.isfinite(table["section"]).any():
        out["section"] = np.nan_to_num(table["section"][rows]).astype(np.int32)
    if np.isfinite(table["elevation_m"]).any():
        out["elevation_m"] = table["elevation_m"][rows]
    if np.isfinite(placed.flow_sd_kg_s).any():
        with np.errstate(invalid="ignore", divide="ignore"):
            out["yield_sd_t_ha"] = placed.flow_sd_kg_s[rows] * interval / ground.area_m2[rows] * T_HA_PER_KG_M2
    bushels_kg = row_bushels_kg(result.crops)
    if np.isfinite(bushels_kg).any():
        out["yield_bu_ac"] = amount * M2_PER_ACRE / bushels_kg[rows]
    out["measured_flow_kg_s"] = table["flow_kg_s"][rows]
    out["measured_moisture_pct"] = table["moisture_pct"][rows]
    out["kept"] = result.cleaned.kept[rows]
    out["reason"] = np.array(result.cleaned.names, dtype=object)[result.cleaned.reason[rows]]
    for name, values in table.extra.items():
        out[name] = values[rows]
    return {
        name: np.where(np.isfinite(values), values, np.nan) if values.dtype == np.float64 else values
        for name, values in out.items()
    }


def unix_to_datetime(time_s: NDArray[np.float64]) -> NDArray[np.datetime64]:
    """Milliseconds; not a time for NaN."""
    known = np.isfinite(time_s)
    out = np.round(np.where(known, time_s, 0.0) * 1000.0).astype(np.int64).astype("datetime64[ms]")
    out[~known] = np.datetime64("NaT", "ms")
    return out
