"""ISO 11783-10 task data as measured: a task and a binary time log for each machine, field and crop, zipped.

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

ENTRIES = task_data.entries_of(
    ddi.WIDTH, ddi.MASS_PER_AREA, ddi.MASS_PER_TIME, ddi.TOTAL_MASS, ddi.MOISTURE, ddi.TOTAL_AREA, ddi.WORK_STATE, ddi.LATENCY
)
_NAMELESS = "field"
"""Name of one that has none."""


def write(folder: Path, result: HarvestMap, grid: Grid) -> list[Path]:
    """`taskdata.zip` with the folder TASKDATA in it."""
    place_of_row, names = _places(result)
    logs = [(place, _log(result, mine, number)) for number, (place, mine) in enumerate(_parts(result, place_of_row), 1)]
    if not logs:
        return []
    areas_m2 = np.bincount(place_of_row, result.ground.area_m2, len(names)).tolist()
    content = task_data.files_of(_tasks(logs, names, areas_m2), ENTRIES, [log for _, log in logs])
    path = folder / FILES["taskdata"][0]
    with scratch_for(path) as scratch, zipfile.ZipFile(scratch, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, data in content.items():
            archive.writestr(zipfile.ZipInfo(f"{task_data.FOLDER}/{name}"), data, zipfile.ZIP_DEFLATED)
    return [path]


def _places(result: HarvestMap) -> tuple[Index, list[tuple[str, str]]]:
    """The place of each row, a field with one crop in it, and field and crop of each place."""
    field, crop = result.table.labels["field"], result.crops
    crops = max(len(crop.names), 1)
    found, of_row = np.unique(field.codes.astype(np.int64) * crops + crop.codes, return_inverse=True)
    names = [(field.names[code // crops] or _NAMELESS, crop.names[code % crops]) for code in found.tolist()]
    return of_row.reshape(-1), names


def _parts(result: HarvestMap, place_of_row: Index) -> list[tuple[int, Index]]:
    """Each machine's places and its steps there, as far as it has a position and a time in them; the steps of a place without any
    are with the machine's first."""
    steps = result.steps
    _, first_row = np.unique(steps.step_of_row, return_index=True)
    place = place_of_row[first_row]
    placed = _placed(result)
    parts = []
    for stream in np.unique(steps.stream):
        mine = steps.stream == stream
        visited = list(dict.fromkeys(place[mine & placed].tolist()))
        if visited:
            place[mine & ~np.isin(place, visited)] = visited[0]
        parts += [(one, np.flatnonzero(mine & (place == one))) for one in visited]
    return parts


def _placed(result: HarvestMap) -> Flags:
    return np.isfinite(result.steps.x_m) & np.isfinite(result.steps.time_s)


def _log(result: HarvestMap, mine: Index, number: int) -> task_data.Log:
    """Some of a machine's steps."""
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
    first_s, last_s = float(time[0]), float(time[-1])
    first, last = (task_data.EPOCH + timedelta(seconds=since_s) for since_s in (first_s, last_s))
    return task_data.Log(
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


def _tasks(logs: list[tuple[int, task_data.Log]], names: list[tuple[str, str]], areas_m2: list[float]) -> ET.Element:
    """names, areas_m2: of each place, which the logs name by its number."""
    root = task_data.task_data()
    places = list(dict.fromkeys(place for place, _ in logs))
    named = filter(None, dict.fromkeys(names[place][1] for place in places))
    crops = {name: f"CTP{number}" for number, name in enumerate(named, 1)}
    for name, key in crops.items():
        ET.SubElement(root, "CTP", A=key, B=name[:32])
    task_data.add_combine(root, ENTRIES)
    keys = {place: f"PFD{number}" for number, place in enumerate(places, 1)}
    for place, key in keys.items():
        field, crop = names[place]
        known = {"A": key, "C": _clean(field), "D": str(round(areas_m2[place]))}
        ET.SubElement(root, "PFD", known | ({"G": crops[crop]} if crop else {}))
    for number, (place, log) in enumerate(logs, 1):
        task_data.add_task(root, f"TSK{number}", f"Harvest {_clean(names[place][0])}"[:32], keys[place], log)
    return root


def _clean(name: str) -> str:
    return "".join(letter for letter in name if letter.isprintable())[:32] or _NAMELESS
