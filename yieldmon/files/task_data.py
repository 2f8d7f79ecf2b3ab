"""ISO 11783-10 task data: the parts of TASKDATA.XML and of a time log's header that do not depend on what was measured.

Layout: ISO 11783-10:2015; values by the data dictionary of ISO 11783-11.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from yieldmon import __version__, utc
from yieldmon import data_dictionary as ddi

EPOCH = datetime(1980, 1, 1, tzinfo=UTC)
"""Day 0 of a time log."""
DAY_MS = 86_400_000
"""Of a time log's records, which count the days and milliseconds within them."""
FOLDER, MAIN_FILE = "TASKDATA", "TASKDATA.XML"
DEVICE, COMBINE = "DVC-1", "DET-1"
"""Identifiers of the combine as a device and as that device's one element."""
SOFTWARE = "yieldmon"
"""That wrote it."""
_CLIENT_NAME, _LATENCY_OBJECT = "A000840000000000", "99"


@dataclass(frozen=True)
class Entry:
    """A data dictionary entry: identifier, designator, unit of the raw integer, and whether it counts up."""

    ddi: int
    designator: str
    unit: str
    total: bool = False


_ENTRIES = {
    entry.ddi: entry
    for entry in (
        Entry(ddi.WIDTH, "Actual working width", "mm"),
        Entry(ddi.MASS_PER_AREA, "Mass per area yield", "mg/m2"),
        Entry(ddi.MASS_PER_TIME, "Mass per time yield", "mg/s"),
        Entry(ddi.TOTAL_MASS, "Yield total mass", "kg", total=True),
        Entry(ddi.MOISTURE, "Crop moisture", "ppm"),
        Entry(ddi.TOTAL_AREA, "Total area", "m2", total=True),
        Entry(ddi.WORK_STATE, "Actual work state", ""),
        Entry(ddi.LATENCY, "Actual value time latency", "ms"),
        Entry(ddi.DRY_PER_AREA, "Dry mass per area yield", "mg/m2"),
        Entry(ddi.DRY_PER_TIME, "Dry mass per time yield", "mg/s"),
        Entry(ddi.DRY_TOTAL, "Yield total dry mass", "kg", total=True),
        Entry(ddi.REFERENCE_MOISTURE, "Reference moisture for dry mass", "ppm"),
        Entry(ddi.HOLD, "Yield hold status", ""),
    )
}


def entries_of(*numbers: int) -> tuple[Entry, ...]:
    """The entries with these identifiers, in this order."""
    return tuple(_ENTRIES[number] for number in numbers)


@dataclass(frozen=True)
class Log:
    """A time log.

    Parameters
    ----------
    name : str
        Of its files, without an ending.
    content : bytes
        The records.
    first, last : datetime
        Of the records.
    duration_s : int
    totals : mapping
        DDI -> last raw value, of entries that count up.
    """

    name: str
    content: bytes
    first: datetime
    last: datetime
    duration_s: int
    totals: Mapping[int, int]


def log_header(entries: Sequence[Entry]) -> ET.Element:
    """The time log's header: what each record holds. Empty attributes are in the binary records."""
    time = ET.Element("TIM", A="", D="4")
    ET.SubElement(time, "PTN", A="", B="", D="")
    for entry in entries:
        ET.SubElement(time, "DLV", A=f"{entry.ddi:04X}", B="", C=COMBINE)
    return time


def task_data() -> ET.Element:
    """TASKDATA.XML's root, empty."""
    return ET.Element(
        "ISO11783_TaskData",
        VersionMajor="4",
        VersionMinor="3",
        ManagementSoftwareManufacturer=SOFTWARE,
        ManagementSoftwareVersion=__version__,
        TaskControllerManufacturer=SOFTWARE,
        TaskControllerVersion=__version__,
        DataTransferOrigin="2",
    )


def add_combine(root: ET.Element, entries: Sequence[Entry], latency_ms: int | None = None) -> None:
    """The device that measures these entries, into the root. latency_ms: of its values, where it is the same in all."""
    device = ET.SubElement(
        root,
        "DVC",
        A=DEVICE,
        B="yieldmon",
        C=__version__[:32],
        D=_CLIENT_NAME,
        E="1",
        F="31000000000000",
        G="000000000000FF",
    )
    combine = ET.SubElement(device, "DET", A=COMBINE, B="1", C="1", D="combine", E="0", F="0")
    for index in range(len(entries)):
        ET.SubElement(combine, "DOR", A=str(10 + index))
    if latency_ms is not None:
        ET.SubElement(combine, "DOR", A=_LATENCY_OBJECT)
    for index, entry in enumerate(entries):
        method = "16" if entry.total else "1"
        attributes = {"A": str(10 + index), "B": f"{entry.ddi:04X}", "C": "0", "D": method, "E": entry.designator}
        ET.SubElement(device, "DPD", attributes | ({"F": str(50 + index)} if entry.unit else {}))
    if latency_ms is not None:
        ET.SubElement(
            device, "DPT", A=_LATENCY_OBJECT, B=f"{ddi.LATENCY:04X}", C=str(latency_ms), D=_ENTRIES[ddi.LATENCY].designator
        )
    for index, entry in enumerate(entries):
        if entry.unit:
            ET.SubElement(device, "DVP", A=str(50 + index), B="0", C="1", D="0", E=entry.unit)


def add_task(root: ET.Element, key: str, title: str, field_key: str, log: Log) -> None:
    """A task that is done, with its one time log, into the root."""
    task = ET.SubElement(root, "TSK", A=key, B=title, E=field_key, G="4")
    time = ET.SubElement(task, "TIM", A=utc.text(log.first), B=utc.text(log.last), C=str(log.duration_s), D="4")
    for number, value in log.totals.items():
        ET.SubElement(time, "DLV", A=f"{number:04X}", B=str(value), C=COMBINE)
    ET.SubElement(task, "DAN", A=_CLIENT_NAME, C=DEVICE)
    ET.SubElement(task, "TLG", A=log.name, B=str(len(log.content)), C="1")


def files_of(root: ET.Element, entries: Sequence[Entry], logs: Sequence[Log]) -> dict[str, bytes]:
    """File name -> content of a TASKDATA folder."""
    content = {MAIN_FILE: as_file(root)}
    for log in logs:
        content |= {f"{log.name}.xml": as_file(log_header(entries)), f"{log.name}.bin": log.content}
    return content


def as_file(root: ET.Element) -> bytes:
    """The file's content, indented."""
    ET.indent(root)
    text: str = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()
