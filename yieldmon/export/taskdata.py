"""Yield points as ISO 11783-10 task data: TASKDATA.XML, and for each field and crop a binary time log with its header file.

Layout: ISO 11783-10:2015 (XML elements, binary time log); values by the data dictionary of ISO 11783-11. Times are UTC.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

from yieldmon import data_dictionary as ddi
from yieldmon import utc
from yieldmon.errors import InputError
from yieldmon.files import task_data
from yieldmon.files.plain_text import plain
from yieldmon.files.whole_file import scratch_folder_for, scratch_for

from .points import YieldPoint

FOLDER = task_data.FOLDER
FILES = (task_data.MAIN_FILE, "TLG00001.xml", "TLG00001.bin")
"""In it, where all grain is of one field and crop."""

ENTRIES = task_data.entries_of(
    ddi.MASS_PER_TIME, ddi.MASS_PER_AREA, ddi.TOTAL_MASS, ddi.MOISTURE, ddi.DRY_PER_AREA, ddi.DRY_PER_TIME, ddi.DRY_TOTAL,
    ddi.REFERENCE_MOISTURE, ddi.HOLD, ddi.WIDTH,
)  # fmt: skip
_TOTALS = tuple(entry.ddi for entry in ENTRIES if entry.total)
_LAST_DAY = 65_535
_INDEX = {entry.ddi: index for index, entry in enumerate(ENTRIES)}


def raw_values(point: YieldPoint, total_kg: float, total_dry_kg: float | None, reference_moisture_pct: float) -> dict[int, int]:
    """DDI -> raw integer of what is known at a point. total_kg, total_dry_kg: of the task, this point included."""
    known: dict[int, float | None] = {
        ddi.MASS_PER_TIME: point.mass_flow_kg_s * 1e6,
        ddi.MASS_PER_AREA: point.yield_kg_m2 * 1e6,
        ddi.TOTAL_MASS: total_kg,
        ddi.MOISTURE: None if point.moisture_pct is None else point.moisture_pct * 1e4,
        ddi.DRY_PER_AREA: None if point.dry_yield_kg_m2 is None else point.dry_yield_kg_m2 * 1e6,
        ddi.DRY_PER_TIME: None if point.dry_mass_flow_kg_s is None else point.dry_mass_flow_kg_s * 1e6,
        ddi.DRY_TOTAL: total_dry_kg,
        ddi.REFERENCE_MOISTURE: reference_moisture_pct * 1e4,
        ddi.HOLD: float(point.held),
        ddi.WIDTH: point.swath_m * 1e3,
    }
    return {number: round(value) for number, value in known.items() if value is not None}


def binary_log(points: Sequence[YieldPoint], reference_of: Callable[[int | None], float]) -> tuple[bytes, dict[int, int]]:
    """The records of the time log, and the last raw value of each total.

    A record: ms since midnight (uint32), days since 1980-01-01 (uint16), north and east in 1e-7 deg (int32), position status
    (uint8, 1 GNSS fix), number of values (uint8), then each value's place in the header (uint8) and raw value (int32).
    """
    records, totals = [], dict.fromkeys(_TOTALS, 0)
    total_kg, total_dry_kg = 0.0, 0.0
    dry_known = True
    for point in points:
        total_kg += point.mass_kg
        dry_known = dry_known and point.dry_mass_flow_kg_s is not None
        total_dry_kg += (point.dry_mass_flow_kg_s or 0.0) * point.duration_s
        values = raw_values(point, total_kg, total_dry_kg if dry_known else None, reference_of(point.load_number))
        totals |= {ddi: values[ddi] for ddi in _TOTALS if ddi in values}
        since = utc.moment(round(point.time_s, 3)) - task_data.EPOCH
        milliseconds = since.seconds * 1000 + round(since.microseconds / 1000)
        north, east = round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7)
        records.append(struct.pack("<IHiiBB", milliseconds, since.days, north, east, 1, len(values)))
        records += [struct.pack("<Bi", _INDEX[ddi], value) for ddi, value in values.items()]
    if not dry_known:
        del totals[ddi.DRY_TOTAL]
    return b"".join(records), totals


def files(
    points: Sequence[YieldPoint], names_of: Callable[[int | None], tuple[str, str]], reference_of: Callable[[int | None], float]
) -> dict[str, bytes]:
    """File name -> content of a TASKDATA folder. names_of: field and crop, "" where that is not known, of a load by its number.
    Raises ValueError without points."""
    if not points:
        raise ValueError("no points")
    places: dict[tuple[str, str], list[YieldPoint]] = {}
    for point in points:
        places.setdefault(names_of(point.load_number), []).append(point)
    crops = {name: f"CTP{number}" for number, name in enumerate(filter(None, dict.fromkeys(crop for _, crop in places)), 1)}
    root = task_data.task_data()
    for name, key in crops.items():
        ET.SubElement(root, "CTP", A=key, B=name)
    # The values are those of their places.
    task_data.add_combine(root, ENTRIES, latency_ms=0)
    for number, ((field, crop), own) in enumerate(places.items(), 1):
        area_m2 = round(sum(point.distance_m * point.swath_m for point in own))
        known = {"A": f"PFD{number}", "C": field, "D": str(area_m2)}
        ET.SubElement(root, "PFD", known | ({"G": crops[crop]} if crop else {}))
    logs = []
    for number, ((field, _), own) in enumerate(places.items(), 1):
        logs.append(_log(f"TLG{number:05d}", own, reference_of))
        task_data.add_task(root, f"TSK{number}", f"Harvest {field}", f"PFD{number}", logs[-1])
    return task_data.files_of(root, ENTRIES, logs)


def _log(name: str, points: Sequence[YieldPoint], reference_of: Callable[[int | None], float]) -> task_data.Log:
    content, totals = binary_log(points, reference_of)
    first, last = (utc.moment(end(point.time_s for point in points)) for end in (min, max))
    return task_data.Log(name, content, first, last, round((last - first).total_seconds()), totals)


def _refuse_other_times(path: Path, points: Sequence[YieldPoint]) -> None:
    for point in points:
        at = utc.moment(point.time_s)
        if not 0 <= (at - task_data.EPOCH).days <= _LAST_DAY:
            expected = "times from 1980 to 2159; .geojson, .gpkg and .txt take those of a clock without a date"
            raise InputError(str(path), f"task data cannot hold a point of {utc.text(at)}", expected)


def write(
    path: Path,
    points: Sequence[YieldPoint],
    names_of: Callable[[int | None], tuple[str, str]],
    reference_of: Callable[[int | None], float],
) -> None:
    """A zip with the folder TASKDATA in it for a name that ends in .zip, else that folder inside `path`. names_of: as in `files`.
    reference_of: moisture of a load's dry mass, %, by its number. Raises InputError for a time or mass that the format cannot
    hold, and for a folder with a log that these data would not replace."""
    _refuse_other_times(path, points)
    try:
        content = files(points, lambda load: _plain(*names_of(load)), reference_of)
    except (struct.error, OverflowError) as error:
        raise InputError(str(path), f"a point does not fit task data: {error}", "masses below 2 Mt") from error
    if path.suffix.lower() == ".zip":
        with scratch_for(path) as scratch, zipfile.ZipFile(scratch, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in content.items():
                archive.writestr(zipfile.ZipInfo(f"{FOLDER}/{name}"), data, zipfile.ZIP_DEFLATED)
        return
    folder = path / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    # Readers take a log that no task names for harvest, too.
    left = sorted(log.name for log in folder.glob("TLG*.bin") if log.name not in content)
    if left:
        raise InputError(str(folder), f"holds logs that these task data do not replace ({', '.join(left[:3])})", "another folder")
    with scratch_folder_for(folder, content) as scratch:
        for name, data in content.items():
            (scratch / name).write_bytes(data)


def _plain(field: str, crop: str) -> tuple[str, str]:
    return plain(field), plain(crop)
