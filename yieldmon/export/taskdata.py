"""Yield points as ISO 11783-10 task data: TASKDATA.XML and a binary time log with its header file.

Layout: ISO 11783-10:2015 (XML elements, binary time log); values by the data dictionary of ISO 11783-11. Times are UTC.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from yieldmon import __version__
from yieldmon.errors import InputError
from yieldmon.files.plain_text import plain
from yieldmon.files.whole_file import scratch_for

from .points import YieldPoint

LOG_NAME = "TLG00001"
FOLDER = "TASKDATA"
_EPOCH = datetime(1980, 1, 1, tzinfo=UTC)
_DEVICE, _COMBINE = "DVC-1", "DET-1"


@dataclass(frozen=True)
class Entry:
    """A data dictionary entry: identifier, designator, and unit of the raw integer."""

    ddi: int
    designator: str
    unit: str


ENTRIES = (
    Entry(87, "Mass per time yield", "mg/s"),
    Entry(84, "Mass per area yield", "mg/m2"),
    Entry(90, "Yield total mass", "kg"),
    Entry(99, "Crop moisture", "ppm"),
    Entry(181, "Dry mass per area yield", "mg/m2"),
    Entry(182, "Dry mass per time yield", "mg/s"),
    Entry(183, "Yield total dry mass", "kg"),
    Entry(184, "Reference moisture for dry mass", "ppm"),
    Entry(239, "Yield hold status", ""),
)
_TOTALS = (90, 183)
_INDEX = {entry.ddi: index for index, entry in enumerate(ENTRIES)}


def raw_values(point: YieldPoint, total_kg: float, total_dry_kg: float | None, reference_moisture_pct: float) -> dict[int, int]:
    """DDI -> raw integer of what is known at a point. total_kg, total_dry_kg: of the task, this point included."""
    known: dict[int, float | None] = {
        87: point.mass_flow_kg_s * 1e6,
        84: point.yield_kg_m2 * 1e6,
        90: total_kg,
        99: None if point.moisture_pct is None else point.moisture_pct * 1e4,
        181: None if point.dry_yield_kg_m2 is None else point.dry_yield_kg_m2 * 1e6,
        182: None if point.dry_mass_flow_kg_s is None else point.dry_mass_flow_kg_s * 1e6,
        183: total_dry_kg,
        184: reference_moisture_pct * 1e4,
        239: float(point.held),
    }
    return {ddi: round(value) for ddi, value in known.items() if value is not None}


def binary_log(points: Sequence[YieldPoint], reference_moisture_pct: float) -> tuple[bytes, dict[int, int]]:
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
        values = raw_values(point, total_kg, total_dry_kg if dry_known else None, reference_moisture_pct)
        totals |= {ddi: values[ddi] for ddi in _TOTALS if ddi in values}
        since = datetime.fromtimestamp(round(point.time_s, 3), UTC) - _EPOCH
        milliseconds = since.seconds * 1000 + round(since.microseconds / 1000)
        north, east = round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7)
        records.append(struct.pack("<IHiiBB", milliseconds, since.days, north, east, 1, len(values)))
        records += [struct.pack("<Bi", _INDEX[ddi], value) for ddi, value in values.items()]
    if not dry_known:
        del totals[183]
    return b"".join(records), totals


def header() -> ET.Element:
    """The time log's header: what each record holds. Empty attributes are in the binary records."""
    time = ET.Element("TIM", A="", D="4")
    ET.SubElement(time, "PTN", A="", B="", D="")
    for entry in ENTRIES:
        ET.SubElement(time, "DLV", A=f"{entry.ddi:04X}", B="", C=_COMBINE)
    return time


def task_file(
    points: Sequence[YieldPoint], totals: Mapping[int, int], log_bytes: int, field: str, reference_moisture_pct: float
) -> ET.Element:
    """TASKDATA.XML's root. Raises ValueError without points."""
    if not points:
        raise ValueError("no points")
    root = ET.Element(
        "ISO11783_TaskData",
        VersionMajor="4",
        VersionMinor="3",
        ManagementSoftwareManufacturer="yieldmon",
        ManagementSoftwareVersion=__version__,
        TaskControllerManufacturer="yieldmon",
        TaskControllerVersion=__version__,
        DataTransferOrigin="2",
    )
    device = ET.SubElement(
        root,
        "DVC",
        A=_DEVICE,
        B="yieldmon",
        C=__version__,
        D="A000840000000000",
        E="1",
        F="31000000000000",
        G="000000000000FF",
    )
    combine = ET.SubElement(device, "DET", A=_COMBINE, B="1", C="1", D="combine", E="0", F="0")
    for index in range(len(ENTRIES)):
        ET.SubElement(combine, "DOR", A=str(10 + index))
    for index, entry in enumerate(ENTRIES):
        method = "16" if entry.ddi in _TOTALS else "1"
        attributes = {"A": str(10 + index), "B": f"{entry.ddi:04X}", "C": "0", "D": method, "E": entry.designator}
        ET.SubElement(device, "DPD", attributes | ({"F": str(50 + index)} if entry.unit else {}))
    for index, entry in enumerate(ENTRIES):
        if entry.unit:
            ET.SubElement(device, "DVP", A=str(50 + index), B="0", C="1", D="0", E=entry.unit)
    area_m2 = sum(point.distance_m * point.swath_m for point in points)
    ET.SubElement(root, "PFD", A="PFD1", C=field, D=str(round(area_m2)))
    task = ET.SubElement(root, "TSK", A="TSK1", B=f"Harvest {field}", E="PFD1", G="4")
    first, last = (datetime.fromtimestamp(points[k].time_s, UTC) for k in (0, -1))
    seconds = round((last - first).total_seconds())
    time = ET.SubElement(task, "TIM", A=_iso(first), B=_iso(last), C=str(seconds), D="4")
    for ddi, value in totals.items():
        ET.SubElement(time, "DLV", A=f"{ddi:04X}", B=str(value), C=_COMBINE)
    ET.SubElement(task, "DAN", A=device.attrib["D"], C=_DEVICE)
    ET.SubElement(task, "TLG", A=LOG_NAME, B=str(log_bytes), C="1")
    return root


def _iso(moment: datetime) -> str:
    return moment.strftime("%Y-%m-%dT%H:%M:%SZ")


def files(points: Sequence[YieldPoint], field: str, reference_moisture_pct: float) -> dict[str, bytes]:
    """File name -> content of a TASKDATA folder."""
    log, totals = binary_log(points, reference_moisture_pct)
    return {
        "TASKDATA.XML": _document(task_file(points, totals, len(log), field, reference_moisture_pct)),
        f"{LOG_NAME}.xml": _document(header()),
        f"{LOG_NAME}.bin": log,
    }


def _document(root: ET.Element) -> bytes:
    ET.indent(root)
    text: str = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def write(path: Path, points: Sequence[YieldPoint], field: str, reference_moisture_pct: float) -> None:
    """A zip with the folder TASKDATA in it for a name that ends in .zip, else that folder inside `path`."""
    try:
        content = files(points, plain(field), reference_moisture_pct)
    except (struct.error, OverflowError) as error:
        expected = "times from 1980 to 2159 and masses below 2 Mt"
        raise InputError(str(path), f"a point does not fit task data: {error}", expected) from error
    if path.suffix.lower() == ".zip":
        with scratch_for(path) as scratch, zipfile.ZipFile(scratch, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in content.items():
                archive.writestr(zipfile.ZipInfo(f"{FOLDER}/{name}"), data)
        return
    folder = path / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in content.items():
        with scratch_for(folder / name) as scratch:
            scratch.write_bytes(data)
