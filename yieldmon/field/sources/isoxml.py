"""ISO 11783-10 task data: TASKDATA.XML with its binary time logs, as a folder, the file itself, or zipped.

Values by the data dictionary of ISO 11783-11. A log that is missing or damaged is named and left out; identifiers that the
dictionary leaves to makers are kept as they are.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from yieldmon.data_dictionary import (
    DEFAULT_WIDTH,
    LAG,
    LATENCY,
    LEAD,
    LENGTH_OF_CUT,
    MAX_WIDTH,
    MOISTURE,
    TOTAL_AREA,
    TOTAL_MASS,
    WIDTH,
)
from yieldmon.errors import InputError, brief
from yieldmon.field.copies import without_copies
from yieldmon.field.leaps import bridged
from yieldmon.field.plane import astray, places_m
from yieldmon.field.table import DEFAULT_FLOW_S, FORAGE_FLOW_S, Array, HarvestTable, Label, Skipped, Source, build, joined
from yieldmon.files.task_data import FOLDER, MAIN_FILE, SOFTWARE

from .columns.crop_names import crop_names
from .columns.positions import plausible
from .damage import ZIP_DAMAGE, may_be_harvest
from .options import ReadOptions
from .task_data import timelog
from .task_data.task_flow import Driven, flow_kg_s
from .task_data.task_geometry import header_from_antenna
from .task_data.task_values import KNOWN, Devices, Values, devices

KIND = "ISO 11783-10 task data"
ORDER = 10
MAX_MEMBER_BYTES = 1 << 30

# Some tasks' logs have four digits.
_PART_NAME = re.compile(r"^([A-Z]{3}\d{5}|TLG\d+)\.(XML|BIN)$")
_LOG_NAME = re.compile(r"^TLG\d+$", re.IGNORECASE)
_LONGEST_INTERVAL_S = 10.0
_AT_ONCE_S = 60.0
"""For how long logs of one device are recorded at once before they are of several machines."""


@dataclass(frozen=True)
class Folder:
    """Files by name in capitals, and a way to read them."""

    where: str
    names: Mapping[str, str]
    get: Callable[[str], bytes]

    def bytes_of(self, name: str) -> bytes:
        """Content. Raises InputError where it is missing or cannot be read."""
        real = self.names.get(name.upper())
        if real is None:
            raise InputError(f"{self.where}: {name}", "is missing", "all files that TASKDATA.XML names")
        try:
            return self.get(real)
        except ZIP_DAMAGE as error:
            raise InputError(f"{self.where}: {name}", f"cannot be read: {brief(error)}", "a file that can be read") from error


def recognises(path: Path, head: bytes) -> bool:
    """A folder or zip with TASKDATA.XML or logs in it, or that file."""
    if path.is_dir():
        home = _task_folder(path)
        if home is None:
            return False
        others = [child for child in path.iterdir() if child != home and not is_task_part(child.name)]
        return not any(child.is_dir() or may_be_harvest(child.name) for child in others)
    if zipfile.is_zipfile(path):
        try:
            with zipfile.ZipFile(path) as archive:
                names = [name.replace("\\", "/") for name in archive.namelist()]
            homes = {_folder_and_file(name)[0] for name in names if is_task_member(name)}
            return len(homes) == 1 and not any(may_be_harvest(name) and not is_task_part(name) for name in names)
        except ZIP_DAMAGE:
            return False
    return path.name.upper() == MAIN_FILE or b"<ISO11783_TaskData" in head


def is_task_member(name: str) -> bool:
    """Whether a file of this name says that its folder holds task data."""
    base = _folder_and_file(name)[1].upper()
    return base == MAIN_FILE or (base.endswith(".BIN") and bool(_LOG_NAME.match(base[:-4])))


def is_task_part(name: str) -> bool:
    """Whether a file of this name belongs to task data: the task file, a log, a grid, or an outsourced part."""
    base = _folder_and_file(name)[1].upper()
    return base in (MAIN_FILE, "LINKLIST.XML") or bool(_PART_NAME.match(base))


def _folder_and_file(name: str) -> tuple[str, str]:
    """Of a zip's member, whose folders may be parted by backslashes."""
    folder, _, file = name.replace("\\", "/").rpartition("/")
    return folder, file


def _task_folder(path: Path) -> Path | None:
    for folder in (path, *sorted(child for child in path.iterdir() if child.is_dir() and child.name.upper() == FOLDER)):
        if any(is_task_member(child.name) for child in folder.iterdir() if child.is_file()):
            return folder
    return None


def _open(path: Path) -> Folder:
    if path.is_dir() or path.name.upper() == MAIN_FILE:
        folder = (_task_folder(path) or path) if path.is_dir() else path.parent
        return Folder(
            str(path),
            {child.name.upper(): child.name for child in folder.iterdir() if child.is_file()},
            lambda name: _content(folder / name),
        )
    if not zipfile.is_zipfile(path):
        return Folder(
            str(path),
            {child.name.upper(): child.name for child in path.parent.iterdir() if child.is_file()} | {MAIN_FILE: path.name},
            lambda name: _content(path.parent / name),
        )
    with zipfile.ZipFile(path) as archive:
        members = [info.filename for info in archive.infolist() if not info.is_dir()]
    home = next(_folder_and_file(name)[0] for name in members if is_task_member(name))
    parted = ((_folder_and_file(name), name) for name in members)
    here = {file.upper(): name for (folder, file), name in parted if folder == home}

    def get(name: str) -> bytes:
        with zipfile.ZipFile(path) as archive:
            _refuse_large(archive.getinfo(name).file_size)
            return archive.read(name)

    return Folder(str(path), here, get)


def _content(path: Path) -> bytes:
    _refuse_large(path.stat().st_size)
    return path.read_bytes()


def _refuse_large(size: int) -> None:
    if size > MAX_MEMBER_BYTES:
        raise OSError(f"larger than {MAX_MEMBER_BYTES} bytes")


@dataclass(frozen=True)
class _Task:
    """A log's task: names for its rows, and the totals that the task states, where it has one log and states them once."""

    log: str
    task: str = ""
    field: str = ""
    crop: str = ""
    mass_kg: float | None = None
    area_m2: float | None = None


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """All logs that can be read. Raises InputError where there is none with a yield and positions."""
    folder = _open(path)
    skipped: list[Skipped] = []
    try:
        root = timelog.xml_root(folder.bytes_of(MAIN_FILE), MAIN_FILE)
    except InputError as error:
        skipped.append(Skipped(MAIN_FILE, error.problem))
        root = ET.Element("ISO11783_TaskData")
    _take_parts(root, folder, skipped)
    once = without_copies(joined(_logs(root, folder, options, skipped)), least_rows=1)
    whole = joined(_machines_apart(_by_log(once)))
    crop_of_row, of_crop = crop_names(whole.labels["crop"], options.crop)
    whole = replace(whole, labels={**whole.labels, "crop": crop_of_row})
    notes = dict.fromkeys(note for source in whole.sources for note in source.notes)
    skipped += [
        Skipped(f"{_log_of(source.path)}: {one.part}", one.why.replace(f"{folder.where}: ", ""))
        for source in once.sources
        for one in source.skipped
    ]
    source = Source(
        path=str(path),
        kind=KIND,
        points=len(whole),
        skipped=tuple(skipped),
        mass_kg=_total([source.mass_kg for source in once.sources]),
        area_m2=_total([source.area_m2 for source in once.sources]),
        notes=(*of_crop, *notes),
        declared_flow_s=whole.declared_flow_s,
        default_flow_s=whole.default_flow_s,
    )
    return replace(whole, sources=(source,), source_of_row=np.zeros(len(whole), np.int32))


def _total(values: Sequence[float | None]) -> float | None:
    """None where one is not known."""
    known = [value for value in values if value is not None]
    return float(sum(known)) if len(known) == len(values) else None


def _logs(root: ET.Element, folder: Folder, options: ReadOptions, skipped: list[Skipped]) -> list[HarvestTable]:
    """The logs that tasks name, and those of the folder that none does. Adds those that cannot be read to skipped.

    Raises InputError where there is none.
    """
    device, tasks = devices(root), _tasks(root, skipped)
    listed = {task.log.upper() for task in tasks}
    tasks += [
        _Task(name[:-4])
        for name in sorted(folder.names)
        if name.endswith(".BIN") and _LOG_NAME.match(name[:-4]) and name[:-4] not in listed
    ]
    parts = []
    expected: dict[str, None] = {}
    for task in tasks:
        try:
            part, problem = _log(folder, task, device, options)
            if problem:
                skipped.append(Skipped(task.log, problem))
            parts.append(part)
        except InputError as error:
            skipped.append(Skipped(task.log, error.problem))
            expected[error.expected] = None
    if parts:
        return parts
    reasons = "; ".join(f"{one.part}: {one.why}" for one in skipped[:3])
    raise InputError(
        folder.where,
        f"has no log that can be read ({reasons or 'none is named'})",
        next(iter(expected)) if len(expected) == 1 else "a time log with yield and position",
    )


def _machines_apart(parts: Sequence[HarvestTable]) -> list[HarvestTable]:
    """The logs with the names of their machines where there are several; logs of one name that overlap in time are of several."""
    names = [str(part.labels["machine"].text()[0]) for part in parts]
    spans = [(float(np.nanmin(part["time_s"])), float(np.nanmax(part["time_s"]))) for part in parts]
    for name in set(names):
        mine = sorted((k for k, other in enumerate(names) if other == name), key=lambda k: spans[k])
        if any(spans[after][0] + _AT_ONCE_S < spans[before][1] for before, after in pairwise(mine)):
            for k in mine:
                names[k] = f"{name} {_log_of(parts[k].sources[0].path)}".strip()
    several = len(set(names)) > 1
    return [
        replace(part, labels={**part.labels, "machine": Label.constant(name if several else "", len(part))})
        for part, name in zip(parts, names, strict=True)
    ]


def _by_log(table: HarvestTable) -> list[HarvestTable]:
    """The logs that have rows."""
    if len(table.sources) == 1:
        return [table]
    parts = []
    for number, source in enumerate(table.sources):
        part = table.take(table.source_of_row == number)
        if len(part):
            own = np.zeros(len(part), np.int32)
            parts.append(
                replace(
                    part,
                    sources=(source,),
                    source_of_row=own,
                    declared_flow_s=source.declared_flow_s,
                    default_flow_s=source.default_flow_s,
                )
            )
    return parts


def _log_of(path: str) -> str:
    return path.rpartition(": ")[2]


def _take_parts(root: ET.Element, folder: Folder, skipped: list[Skipped]) -> None:
    """Adds to a task file what it has in other files (external file references)."""
    for reference in root.findall("XFR"):
        name = f"{reference.get('A', '')}.XML"
        try:
            root.extend(timelog.xml_root(folder.bytes_of(name), name))
        except InputError as error:
            skipped.append(Skipped(name, error.problem))


def _tasks(root: ET.Element, skipped: list[Skipped]) -> list[_Task]:
    """A log of two tasks is the first one's."""
    fields = {element.get("A", ""): element for element in root.iter("PFD")}
    crops = {element.get("A", ""): element.get("B", "") for element in root.iter("CTP")}
    products = {element.get("A", ""): element.get("B", "") for element in root.iter("PDT")}
    out: list[_Task] = []
    for task in root.iter("TSK"):
        place = fields.get(task.get("E", ""))
        name = "" if place is None else place.get("C", "")
        crop = "" if place is None else crops.get(place.get("G", ""), "")
        product = next((products.get(pan.get("A", ""), "") for pan in task.iter("PAN")), "")
        logs = [log.get("A", "") for log in task.iter("TLG")]
        again = [log for log in logs if any(log.upper() == one.log.upper() for one in out)]
        skipped += [Skipped(log, "is named by two tasks: it counts once") for log in again]
        logs = [log for log in dict.fromkeys(logs) if log not in again]
        mass_kg, area_m2 = (_stated(task, ddi) if len(logs) == 1 else None for ddi in (TOTAL_MASS, TOTAL_AREA))
        out += [_Task(log, task.get("B", "") or task.get("A", ""), name, crop or product, mass_kg, area_m2) for log in logs]
    return out


def _stated(task: ET.Element, ddi: int) -> float | None:
    """A total of a task's times, where there is one: of several it is not said whether each goes on from the one before."""
    values = [
        one.get("B", "") for time in task.iter("TIM") for one in time.iter("DLV") if one.get("A", "").upper() == f"{ddi:04X}"
    ]
    try:
        return float(timelog.process_value(values[0])) if len(values) == 1 else None
    except ValueError:
        return None


def _log(folder: Folder, task: _Task, device: Devices, options: ReadOptions) -> tuple[HarvestTable, str]:
    head = timelog.header(folder.bytes_of(f"{task.log}.XML"), f"{task.log}.xml")
    log = timelog.read(folder.bytes_of(f"{task.log}.BIN"), head)
    count = len(log.time_s)
    where = f"{folder.where}: {task.log}"
    if not count:
        raise InputError(where, log.problem, "records of a binary time log")
    # What means "no position" may be a place of the globe, so distances come after that is taken out.
    places, no_places = plausible({"longitude_deg": log.longitude_deg, "latitude_deg": log.latitude_deg})
    if not np.isfinite(places["longitude_deg"]).any():
        raise InputError(where, "has no positions", "records with PositionNorth and PositionEast")
    of = Values(log.values, device)
    interval, distance = _steps(log.time_s, places["longitude_deg"], places["latitude_deg"])
    width = of.width_m() if options.width_m is None else np.full(count, options.width_m)
    # Asked first: a log without a yield is not made one by --width.
    flow, notes = flow_kg_s(of, Driven(interval, distance, np.full(count, np.nan) if width is None else width), where)
    if width is None:
        raise InputError(where, f"has no working width (DDI {WIDTH}, {DEFAULT_WIDTH} or {MAX_WIDTH})", "--width M")
    moisture = of.one(MOISTURE, 1e-4)
    to_header, of_header = header_from_antenna(of, count)
    columns, limits = plausible(
        {
            "time_s": log.time_s,
            **places,
            "flow_kg_s": flow,
            "interval_s": interval,
            "distance_m": distance,
            "width_m": width,
            "elevation_m": log.elevation_m,
            "moisture_pct": np.full(count, np.nan) if moisture is None else np.where(moisture > 0, moisture, np.nan),
            "header_down": of.header_down(count),
            **to_header,
            **({"cut_right_m": of.cut_right_m(count)} if options.width_m is None else {}),
        }
    )
    labels = {
        "field": Label.constant(options.field or task.field, count),
        "load": Label.constant(task.task, count),
        "crop": Label.constant(task.crop, count),
        "machine": Label.constant(of.device_name(), count),
    }
    table = build(
        columns,
        labels,
        Source(where, KIND, count, (), *_totals(of, task), (*no_places, *notes, *of_header, *limits)),
        unix_time=True,
        declared_flow_s=_declared_s(of),
        default_flow_s=FORAGE_FLOW_S if of.of(LENGTH_OF_CUT) else DEFAULT_FLOW_S,
        extra={f"DDI {ddi:04X} {element}".strip(): values for (ddi, element), values in log.values.items() if ddi not in KNOWN},
    )
    return table, log.problem


def _declared_s(of: Values) -> float | None:
    """From cutting to the sensor as the machine says: the age of its values, else for how long yield does not count at a turn."""
    latency = of.single(LATENCY)
    # Of other makers 0 may be a value that nobody set.
    if latency is not None and (latency < 0 or (latency == 0 and of.device.software == SOFTWARE)):
        return 1e-3 * abs(latency)
    lag = of.single(LAG) or of.single(LEAD)
    return None if lag is None else 1e-3 * lag


def _totals(of: Values, task: _Task) -> tuple[float | None, float | None]:
    """Mass, kg, and area, m2, by the machine's counters in the log, else as the task states them."""
    mass_kg, area_m2 = of.risen(TOTAL_MASS), of.risen(TOTAL_AREA)
    return task.mass_kg if mass_kg is None else mass_kg, task.area_m2 if area_m2 is None else area_m2


def _steps(time_s: Array, longitude_deg: Array, latitude_deg: Array) -> tuple[Array, Array]:
    """Time, s, and distance, m, of each record since the one before; NaN for a distance between unknown places."""
    interval = np.diff(time_s, prepend=time_s[0])
    usual = np.median(interval[interval > 0]) if (interval > 0).any() else 1.0
    longest = max(_LONGEST_INTERVAL_S, 3.0 * usual)
    # After a pause the machine cut for one usual interval and drove as far as in the next, not for all of the pause.
    begins = (interval < 0) | (interval > longest)
    begins[0] = True
    x, y = places_m(longitude_deg, latitude_deg)
    x, y = bridged(np.where(astray(x), np.nan, x), y, time_s, np.zeros(len(time_s), np.intp))
    distance = np.hypot(np.diff(x, prepend=x[0]), np.diff(y, prepend=y[0]))
    found = np.isfinite(x) & ~np.isfinite(np.append(np.nan, x[:-1]))
    distance = np.where(begins | found, np.append(np.where(begins, 0.0, distance)[1:], 0.0), distance)
    return np.where(begins, usual, interval), distance
