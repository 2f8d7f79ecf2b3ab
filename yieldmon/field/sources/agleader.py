"""Ag Leader text, basic and advanced: no header, twelve columns that all dialects share, others after them.

Columns: longitude and latitude in deg, grain flow in lb/s, time in s, logging interval in s, distance and swath in inches,
moisture in %, header status, pass, serial number (not in every dialect), field; then, in varying order, load, grain, product,
GPS status, PDOP, elevation in feet. Positions are those of the receiver when the flow was measured: no delay has been taken out.

Source: Ag Leader Technology, "GPS 2000/2100 Operator's Manual" (April 1998), page 8-7.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from yieldmon.errors import InputError
from yieldmon.field.table import DEFAULT_FLOW_S, HarvestTable, Label, Source, build
from yieldmon.field.units import M_PER_IN
from yieldmon.units import KG_PER_LB

from . import clocks
from .delimited import Rows, delimiter_of, encoding_of, number, read_rows, rows_of
from .options import ReadOptions
from .positions import plausible

KIND = "Ag Leader text"
ORDER = 40
_NUMBERS = range(10)
_FIELD, _LOAD = re.compile(r"^\s*F\d+\s*:"), re.compile(r"^\s*L\d+\s*:")
_MAX_MACHINE_CHANGES = 50
_LOOKED_AT = 20


def recognises(path: Path, head: bytes) -> bool:
    """Whether a line of the first few is ten numbers that begin with a position, and none before it is a header."""
    if path.is_dir() or (b"\0" in head and encoding_of(head) != "utf-16"):
        return False
    lines = head.decode(encoding_of(head), "replace").splitlines()[:_LOOKED_AT]
    for line in lines:
        cells = next(csv.reader([line], delimiter=delimiter_of(line)), []) if line.strip() else []
        if _is_row(cells):
            return True
        if len(cells) > 8 and not any(_is_number(cell) for cell in cells[:8]):
            return False
    return False


def _is_number(cell: str) -> bool:
    try:
        number(cell)
    except ValueError:
        return False
    return bool(cell.strip())


def _is_row(cells: list[str]) -> bool:
    if len(cells) < 10 or not all(_is_number(cell) for cell in cells[:9]):
        return False
    return abs(number(cells[0])) <= 180 and abs(number(cells[1])) <= 90


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """All rows of a file. Raises InputError where none can be read."""
    with path.open("rb") as stream:
        head = stream.read(1 << 16)
    encoding = encoding_of(head)
    sample = [
        line for line in head.decode(encoding, "replace").splitlines()[:-1] or [head.decode(encoding, "replace")] if line.strip()
    ]
    delimiter = delimiter_of(sample[0])
    layout = _layout(sample, delimiter)
    rows = read_rows(rows_of(path, encoding, delimiter), [*_NUMBERS, *layout["numbers"]], layout["texts"], 10)
    if not rows.count:
        raise InputError(
            str(path), "has no row that can be read", "ten numbers and more a row: longitude, latitude, flow in lb/s, ..."
        )
    return _table(path, rows, layout, options)


def _layout(sample: list[str], delimiter: str) -> dict[str, list[int]]:
    """Which columns after the tenth are what, from the rows at the head: serial and elevation are numbers, names are text."""
    cells = [row for row in csv.reader(sample, delimiter=delimiter, skipinitialspace=True) if _is_row(row)][:200]
    width = min((len(row) for row in cells), default=10)
    numeric = [column for column in range(10, width) if all(_is_number(row[column]) for row in cells)]
    text = [column for column in range(10, width) if column not in numeric]
    serial = [10] if 10 in numeric else []
    field = [c for c in text if all(_FIELD.match(row[c]) for row in cells)][:1]
    load = [c for c in text if all(_LOAD.match(row[c]) for row in cells)][:1]
    rest = [c for c in text if c not in field + load and any(row[c].strip().upper() not in ("", "NA") for row in cells)]
    if not field and rest:
        field, rest = rest[:1], rest[1:]
    after = [c for c in numeric if c > (rest or load or field or [10])[-1]]
    elevation = after[2:3] if len(after) >= 3 else []
    return {
        "numbers": serial + elevation,
        "serial": serial,
        "elevation": elevation,
        "field": field,
        "load": load,
        "crop": rest[:1],
        "product": rest[1:2],
        "texts": field + load + rest[:2],
    }


def _table(path: Path, rows: Rows, layout: dict[str, list[int]], options: ReadOptions) -> HarvestTable:
    values = rows.numbers
    time, notes = clocks.unwrapped(values[3])
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
    if layout["elevation"]:
        columns["elevation_m"] = values[layout["elevation"][0]] * 0.3048
    labels = {name: rows.texts[layout[name][0]] for name in ("field", "load", "crop", "product") if layout[name]}
    if options.crop:
        labels["crop"] = Label.constant(options.crop, rows.count)
    if options.field:
        labels["field"] = Label.constant(options.field, rows.count)
    machine = _machine(values[10]) if layout["serial"] else None
    if machine is not None:
        labels["machine"] = machine
    source = Source(str(path), KIND, rows.count, rows.skipped, notes=(*notes, *header_notes, *limits))
    return build(columns, labels, source, unix_time=options.first_date is not None, default_flow_s=DEFAULT_FLOW_S)


def _header(status: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Header down: the lowest bit (33 down, 32 up; 1 down, 0 up). Unknown where it never says down."""
    whole = np.isfinite(status) & (np.abs(status) < 2**31)
    down = np.where(whole, np.mod(np.where(whole, status, 0), 2) >= 1, np.nan).astype(float)
    if not (down == 1).any():
        return np.full(len(status), np.nan), ("the header status never says down and is not used",)
    return down, ()


def _machine(serial: np.ndarray) -> Label | None:
    """Serial numbers as names of machines; a column that goes to and fro, or holds flags, is none."""
    known = np.nan_to_num(serial)
    if known.max(initial=0) <= 1 or (np.diff(known) != 0).sum() > _MAX_MACHINE_CHANGES:
        return None
    return Label.of([f"{value:.0f}" for value in known])
