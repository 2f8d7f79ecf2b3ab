"""ISO 11783-10 task data as measured: a task and a binary time log for each machine and field, zipped.

No delay is taken out; it stands in the log as the latency of its values. The last total of a log is its measured mass.
Layout: ISO 11783-10:2015; values by the data dictionary of ISO 11783-11.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
import zipfile
from datetime import timedelta
from pathlib import Path

import numpy as np

from yieldmon import data_dictionary as ddi
from yieldmon.field.grid import Grid
from yieldmon.field.harvest import HarvestMap
from yieldmon.field.table import Array, Flags, Index
from yieldmon.files import task_data
from yieldmon.files.whole_file import scratch_for
from yieldmon.units import S_PER_DAY

from . import FILES

ENTRIES = (
    task_data.Entry(ddi.WIDTH, "Actual working width", "mm"),
    task_data.Entry(ddi.MASS_PER_AREA, "Mass per area yield", "mg/m2"),
    task_data.Entry(ddi.MASS_PER_TIME, "Mass per time yield", "mg/s"),
    task_data.Entry(ddi.TOTAL_MASS, "Yield total mass", "kg", total=True),
    task_data.Entry(ddi.MOISTURE, "Crop moisture", "ppm"),
    task_data.Entry(ddi.TOTAL_AREA, "Total area", "m2", total=True),
    task_data.Entry(ddi.WORK_STATE, "Actual work state", ""),
    task_data.Entry(ddi.LATENCY, "Actual value time latency", "ms"),
)
_NAMELESS = "field"
"""Name of one that has none."""


def write(folder: Path, result: HarvestMap, grid: Grid) -> list[Path]:
    """`taskdata.zip` with the folder TASKDATA in it."""
    logs = [_log(result, mine, number) for number, mine in enumerate(_parts(result), 1)]
    if not logs:
        return []
    content = task_data.files_of(_tasks(result, logs), ENTRIES, [log for _, log in logs])
    path = folder / FILES["taskdata"][0]
    with scratch_for(path) as scratch, zipfile.ZipFile(scratch, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, data in content.items():
            archive.writestr(zipfile.ZipInfo(f"TASKDATA/{name}"), data, zipfile.ZIP_DEFLATED)
    return [path]


def _parts(result: HarvestMap) -> list[Index]:
    """The steps of each machine in each field, as far as it has a position and a time there; those of a field without any are
    with the machine's first."""
    steps = result.steps
    _, first_row = np.unique(steps.step_of_row, return_index=True)
    field = result.table.labels["field"].codes[first_row].copy()
    placed = _placed(result)
    parts = []
    for stream in np.unique(steps.stream):
        mine = steps.stream == stream
        fields = list(dict.fromkeys(field[mine & placed].tolist()))
        if fields:
            field[mine & ~np.isin(field, fields)] = fields[0]
        parts += [np.flatnonzero(mine & (field == one)) for one in fields]
    return parts


def _placed(result: HarvestMap) -> Flags:
    return np.isfinite(result.steps.x_m) & np.isfinite(result.steps.time_s)


def _log(result: HarvestMap, mine: Index, number: int) -> tuple[str, task_data.Log]:
    """The field of some of a machine's steps, and their log."""
    steps = result.steps
    stream = steps.stream[mine[0]]
    rows = mine[_placed(result)[mine]]
    longitude, latitude = steps.plane.to_deg(steps.x_m[rows], steps.y_m[rows])
    flow = np.nan_to_num(steps.flow_kg_s[rows])
    # Each row of a step has the step's time; what the rows without a position measured goes with the next that has one.
    mass = np.bincount(steps.step_of_row, np.nan_to_num(result.table["flow_kg_s"] * result.table["interval_s"]), len(steps))
    running = np.cumsum(mass[mine])
    total = running[np.searchsorted(mine, rows)]
    total[-1] = running[-1]
    area = np.cumsum(np.bincount(steps.step_of_row, result.ground.area_m2, len(steps))[rows])
    with np.errstate(invalid="ignore", divide="ignore"):
        per_area = flow / (steps.speed_m_s[rows] * steps.width_m[rows])
    machine = next((one for one in result.machines if one.stream == stream), result.machines[0])
    latency_ms = -1000.0 * max(machine.flow.value_s, 0.0)
    values: dict[int, Array] = {
        ddi.WIDTH: steps.width_m[rows] * 1000,
        ddi.MASS_PER_AREA: np.where(np.isfinite(per_area), per_area, 0.0) * 1e6,
        ddi.MASS_PER_TIME: flow * 1e6,
        ddi.TOTAL_MASS: total,
        ddi.MOISTURE: np.nan_to_num(steps.moisture_pct[rows]) * 1e4,
        ddi.TOTAL_AREA: area,
        ddi.WORK_STATE: steps.down[rows].astype(float),
        ddi.LATENCY: np.full(len(rows), latency_ms),
    }
    raw = {number: np.clip(np.round(one), -(2**31) + 1, 2**31 - 1).astype(np.int32) for number, one in values.items()}
    time = _since_epoch(steps.time_s[rows], result.table.unix_time)
    label = result.table.labels["field"]
    first_row = int(np.flatnonzero(steps.step_of_row == rows[0])[0])
    first_s, last_s = float(time[0]), float(time[-1])
    first, last = (task_data.EPOCH + timedelta(seconds=since_s) for since_s in (first_s, last_s))
    return label.names[label.codes[first_row]] or _NAMELESS, task_data.Log(
        f"TLG{number:05d}",
        _records(time, longitude, latitude, raw),
        first,
        last,
        round(last_s - first_s),
        {entry.ddi: int(raw[entry.ddi][-1]) for entry in ENTRIES if entry.total},
    )


def _since_epoch(time_s: Array, unix: bool) -> Array:
    """Seconds since 1980; a clock without a date keeps its time of the day, from the first day on."""
    seconds = time_s - task_data.EPOCH.timestamp() if unix else time_s - np.floor(time_s.min() / S_PER_DAY) * S_PER_DAY
    return np.asarray(np.clip(np.round(seconds, 3), 0.0, 65_535 * S_PER_DAY))


def _records(time: Array, longitude: Array, latitude: Array, raw: dict[int, np.ndarray]) -> bytes:
    kind = np.dtype(
        [
            ("ms", "<u4"),
            ("day", "<u2"),
            ("north", "<i4"),
            ("east", "<i4"),
            ("status", "u1"),
            ("number", "u1"),
            *((f"{part}{entry.ddi}", form) for entry in ENTRIES for part, form in (("i", "u1"), ("v", "<i4"))),
        ]
    )
    out = np.zeros(len(time), kind)
    milliseconds = np.round(time * 1000).astype(np.int64)
    out["day"], out["ms"] = milliseconds // task_data.DAY_MS, milliseconds % task_data.DAY_MS
    out["north"], out["east"] = np.round(latitude * 1e7), np.round(longitude * 1e7)
    out["status"], out["number"] = 1, len(ENTRIES)
    for index, entry in enumerate(ENTRIES):
        out[f"i{entry.ddi}"], out[f"v{entry.ddi}"] = index, raw[entry.ddi]
    return out.tobytes()


def _tasks(result: HarvestMap, logs: list[tuple[str, task_data.Log]]) -> ET.Element:
    root = task_data.task_data()
    if result.crop:
        ET.SubElement(root, "CTP", A="CTP1", B=result.crop[:32])
    task_data.add_combine(root, ENTRIES)
    fields = {name: f"PFD{number + 1}" for number, name in enumerate(dict.fromkeys(field for field, _ in logs))}
    label = result.table.labels["field"]
    area = np.bincount(label.codes, result.ground.area_m2, len(label.names))
    for name, key in fields.items():
        own = round(sum(m2 for one, m2 in zip(label.names, area.tolist(), strict=True) if (one or _NAMELESS) == name))
        ET.SubElement(root, "PFD", {"A": key, "C": _clean(name), "D": str(own)} | ({"G": "CTP1"} if result.crop else {}))
    for number, (field, log) in enumerate(logs, 1):
        task_data.add_task(root, f"TSK{number}", f"Harvest {_clean(field)}"[:32], fields[field], log)
    return root


def _clean(name: str) -> str:
    return "".join(letter for letter in name if letter.isprintable())[:32] or _NAMELESS
