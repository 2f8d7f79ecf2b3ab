"""Ag Leader text, basic and advanced: twelve columns that all dialects share, others after them; without a header, or with one
that names these columns and no other units.

Columns: longitude and latitude in deg, grain flow in lb/s, time in s, logging interval in s, distance and swath in inches,
moisture in %, header status, pass, serial number (not in every dialect), field; then, in varying order, load, grain, product,
GPS status, PDOP, elevation in feet. Positions are those of the receiver when the flow was measured: no delay has been taken out.

Source: Ag Leader Technology, "GPS 2000/2100 Operator's Manual" (April 1998), page 8-7.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from yieldmon.errors import InputError
from yieldmon.field.mixed import apart
from yieldmon.field.plane import places_m
from yieldmon.field.table import DEFAULT_FLOW_S, HarvestTable, Label, Source, build
from yieldmon.units import KG_PER_LB, M_PER_FT, M_PER_IN

from . import csv_table
from .columns import clocks
from .columns.crop_names import crop_names
from .columns.delimited import Rows, delimiter_of, encoding_of, has_decimal_comma, number, read_rows, rows_of
from .columns.naming import QUANTITIES, plain_name, split_unit
from .columns.positions import plausible
from .columns.side_by_side import beside, numbered
from .options import ReadOptions

KIND = "Ag Leader text"
ORDER = 40
_NUMBERS = range(10)
_TAKEN_OUT = re.compile(r"flow delay of (-?\d+(?:\.\d+)?) s taken out")
_FIELD, _LOAD = re.compile(r"^\s*F\d+\s*:"), re.compile(r"^\s*L\d+\s*:")
_MAX_MACHINE_CHANGES, _MAX_MACHINES = 50, 10
_NAMED = (
    ("longitude", ("deg",)),
    ("latitude", ("deg",)),
    ("flow", ("lb/s",)),
    ("time", ("s",)),
    ("interval", ("s",)),
    ("distance", ("in",)),
    ("width", ("in",)),
    ("moisture", ("%",)),
)
"""Names of the first columns, and their units."""
_LOOKED_AT = 20


def taken_out(delay_s: float) -> str:
    """What stands in the last column where the delay is no more in the rows."""
    return f"flow delay of {delay_s:.1f} s taken out"


def recognises(path: Path, head: bytes) -> bool:
    """Whether a line of the first few is ten numbers that begin with a position, and none before it is a header."""
    if path.is_dir() or (b"\0" in head and encoding_of(head) != "utf-16"):
        return False
    lines = head.decode(encoding_of(head), "replace").splitlines()[:_LOOKED_AT]
    for line in lines:
        cells = next(csv.reader([line], delimiter=delimiter_of(line)), []) if line.strip() else []
        if _is_row(cells, comma=has_decimal_comma(cells[:2])):
            return True
        if len(cells) > 8 and not any(_is_number(cell, comma=False) for cell in cells[:8]) and not _is_header(cells):
            return False
    return False


def _is_number(cell: str, *, comma: bool) -> bool:
    try:
        number(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return False
    return bool(cell.strip())


def _is_row(cells: list[str], *, comma: bool) -> bool:
    if len(cells) < 10 or not all(_is_number(cell, comma=comma) for cell in cells[:9]):
        return False
    longitude, latitude = (number(cell.replace(",", ".") if comma else cell) for cell in cells[:2])
    return abs(longitude) <= 180 and abs(latitude) <= 90


def _is_header(cells: list[str]) -> bool:
    """Whether these are the names of this format's first columns, in its units or without any."""
    for cell, (quantity, units) in zip(cells, _NAMED, strict=False):
        name, unit = split_unit(cell.strip())
        if plain_name(name) not in QUANTITIES[quantity].names or unit not in ("", *units):
            return False
    return len(cells) >= 10


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """All rows of a file. Raises InputError where none can be read."""
    with path.open("rb") as stream:
        head = stream.read(1 << 16)
    encoding = encoding_of(head)
    lines = [line for line in head.decode(encoding, "replace").splitlines() if line.strip()]
    # The last one may be cut where the head ends.
    sample = lines[:-1] or lines or [""]
    delimiter = delimiter_of(sample[0])
    first = next(csv.reader(sample[:1], delimiter=delimiter, skipinitialspace=True))
    headed = _is_header(first)
    if headed and options.columns:
        return csv_table.read(path, options)
    layout = _layout(sample, delimiter)
    source = rows_of(path, encoding, delimiter)
    if headed:
        next(source, None)
    rows = read_rows(source, [*_NUMBERS, *layout.numbers], layout.texts, 10, _comma(sample, delimiter))
    if not rows.count:
        raise InputError(
            str(path), "has no row that can be read", "ten numbers and more a row: longitude, latitude, flow in lb/s, ..."
        )
    if not headed or split_unit(first[5].strip())[1]:
        return _table(path, rows, layout, options)
    table = _table(path, rows, layout, options, ("has no units; its columns are those of Ag Leader text: lb/s, s, in, %",))
    if not _distances_fit(table):
        where = f"{path}: header"
        raise InputError(where, "states no units, and the distances are not in inches", "--column flow=NAME:UNIT and so on")
    return table


def _distances_fit(table: HarvestTable) -> bool:
    """Whether the distances that rows give are those between their positions."""
    x, y = places_m(table["longitude_deg"], table["latitude_deg"])
    driven, given = np.hypot(np.diff(x), np.diff(y)), table["distance_m"][1:]
    both = (driven > 0) & (given > 0)
    return not both.any() or bool(0.5 < np.median(given[both] / driven[both]) < 2.0)


def _comma(sample: list[str], delimiter: str) -> bool:
    rows = csv.reader(sample, delimiter=delimiter, skipinitialspace=True)
    return has_decimal_comma(cell for row in rows for cell in row[:2] if _is_number(cell, comma=True))


@dataclass(frozen=True)
class _Layout:
    """Columns after the tenth, each None where there is none: serial number, elevation and texts."""

    serial: int | None
    elevation: int | None
    field: int | None
    load: int | None
    crop: int | None
    product: int | None
    mark: int | None

    @property
    def numbers(self) -> list[int]:
        return _known(self.serial, self.elevation)

    @property
    def texts(self) -> list[int]:
        return _known(*self.labels.values(), self.mark)

    @property
    def labels(self) -> dict[str, int | None]:
        """Name -> column."""
        return {"field": self.field, "load": self.load, "crop": self.crop, "product": self.product}


def _known(*columns: int | None) -> list[int]:
    return [column for column in columns if column is not None]


def _layout(sample: list[str], delimiter: str) -> _Layout:
    """Which columns after the tenth are what, from the rows at the head: serial and elevation are numbers, names are text."""
    comma = _comma(sample, delimiter)
    cells = [row for row in csv.reader(sample, delimiter=delimiter, skipinitialspace=True) if _is_row(row, comma=comma)][:200]
    width = min((len(row) for row in cells), default=10)
    numeric = [column for column in range(10, width) if all(_is_number(row[column], comma=comma) for row in cells)]
    text = [column for column in range(10, width) if column not in numeric]

    def first_where_all(matches: Callable[[str], object]) -> int | None:
        return next((column for column in text if all(matches(row[column]) for row in cells)), None)

    field, load = first_where_all(_FIELD.match), first_where_all(_LOAD.match)
    mark = first_where_all(lambda cell: _TAKEN_OUT.fullmatch(cell.strip()))
    named = {field, load, mark}
    rest = [c for c in text if c not in named and any(row[c].strip().upper() not in ("", "NA") for row in cells)]
    if field is None and rest:
        field = rest.pop(0)
    last_text = rest[-1] if rest else load if load is not None else field if field is not None else 10
    after = [column for column in numeric if column > last_text]
    crop, product, *_ = (*rest, None, None)
    return _Layout(
        serial=10 if 10 in numeric else None,
        elevation=after[2] if len(after) >= 3 else None,
        field=field,
        load=load,
        crop=crop,
        product=product,
        mark=mark,
    )


def _table(path: Path, rows: Rows, layout: _Layout, options: ReadOptions, of_header: tuple[str, ...] = ()) -> HarvestTable:
    values = rows.numbers
    machine = _machine(values[10], values[3]) if layout.serial is not None else None
    time, notes = _clock(values[3], machine)
    if options.first_date is not None:
        time = clocks.dated(time, options.first_date)
    header, header_notes = _header(values[8])
    columns, limits = plausible(
        {
            "longitude_deg": values[0],
            "latitude_deg": values[1],
            "flow_kg_s": values[2] * KG_PER_LB,
            "time_s": time,
            "interval_s": values[4],
            "distance_m": values[5] * M_PER_IN,
            "width_m": values[6] * M_PER_IN,
            "moisture_pct": np.where(values[7] > 0, values[7], np.nan),
            "header_down": header,
            "pass_number": values[9],
        }
    )
    if options.width_m is not None:
        columns["width_m"] = np.full(rows.count, options.width_m)
    codes = np.zeros(rows.count, np.int32) if machine is None else machine.codes
    section = numbered(columns["longitude_deg"], columns["latitude_deg"], columns["width_m"], time, codes)
    if section is not None:
        columns["section"] = section
        notes += (beside(section),)
    if layout.elevation is not None:
        columns["elevation_m"] = values[layout.elevation] * M_PER_FT
    labels = {name: rows.texts[column] for name, column in layout.labels.items() if column is not None}
    labels["crop"], of_crop = crop_names(labels.get("crop", Label.constant("", rows.count)), options.crop)
    if options.field:
        labels["field"] = Label.constant(options.field, rows.count)
    if machine is not None:
        labels["machine"] = machine
    marks = rows.texts[layout.mark].names if layout.mark is not None else ()
    source = Source(
        str(path),
        KIND,
        rows.count,
        rows.skipped,
        notes=(*of_header, *of_crop, *(f"says: {mark}" for mark in marks), *notes, *header_notes, *limits),
        taken_out=bool(marks),
    )
    default_s = 0.0 if marks else DEFAULT_FLOW_S
    return apart(build(columns, labels, source, unix_time=options.first_date is not None, default_flow_s=default_s))


def _header(status: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Header down: the lowest bit (33 down, 32 up; 1 down, 0 up). Unknown where it never says down."""
    whole = np.isfinite(status) & (np.abs(status) < 2**31)
    down = np.where(whole, np.mod(np.where(whole, status, 0), 2) >= 1, np.nan).astype(float)
    if not (down == 1).any():
        return np.full(len(status), np.nan), ("the header status is never down and is not used",)
    return down, ()


def _machine(serial: np.ndarray, time_s: np.ndarray) -> Label | None:
    """Serial numbers as names of machines; a column that holds flags is none, nor one that goes to and fro, unless that is what
    parts two machines whose rows come by turns, each with a clock that goes on."""
    known = np.nan_to_num(serial)
    if known.max(initial=0) <= 1:
        return None
    if (np.diff(known) != 0).sum() > _MAX_MACHINE_CHANGES:
        names = np.unique(known)
        if len(names) > _MAX_MACHINES:
            return None
        stays = sum(_clock_stays(time_s[known == name]) for name in names)
        if 10 * stays > _clock_stays(time_s):
            return None
    return Label.of([f"{value:.0f}" for value in known])


def _clock_stays(time_s: np.ndarray) -> int:
    """How often a row's clock is not after that of the row before."""
    return int((np.diff(time_s) <= 0).sum())


def _clock(time_s: np.ndarray, machine: Label | None) -> tuple[np.ndarray, tuple[str, ...]]:
    """The clock over midnight and the week's end, of each machine by itself."""
    if machine is None or len(machine.names) < 2:
        return clocks.unwrapped(time_s)
    out = time_s.copy()
    notes: list[str] = []
    for code, name in enumerate(machine.names):
        mine = machine.codes == code
        out[mine], said = clocks.unwrapped(time_s[mine])
        notes += [f"machine {name}: {one}" for one in said]
    return out, tuple(notes)
