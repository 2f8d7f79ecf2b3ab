"""CSV with a header, columns found by names that say their unit or by a column map."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from yieldmon.errors import InputError
from yieldmon.field.table import DEFAULT_FLOW_S, HarvestTable
from yieldmon.field.units import BUSHELS, FACTORS, plain_unit
from yieldmon.repeats import repeated

from .assembled import assemble
from .delimited import delimiter_of, encoding_of, has_decimal_comma, read_rows, rows_of
from .naming import QUANTITIES, columns_of
from .options import ReadOptions
from .raw_table import Raw
from .vector import to_degrees

KIND = "CSV with a header"
ORDER = 60
_SEPARATOR = re.compile(r"sep=([,;\t])\s*", re.IGNORECASE)
"""What spreadsheets write above the header."""
_SUFFIXES = (".csv", ".txt", ".tsv")
_OF_A_RECORD = frozenset({"time_s", "mass_flow_kg_s", "load_number", "zero_mv", "usable_for_calibration"})
"""Columns of a table of `yieldmon process` or `export`, whose places are those of the machine: the delay is still in it."""


def recognises(path: Path, head: bytes) -> bool:
    """By its suffix, where it is text with a first line of several names."""
    if path.is_dir() or path.suffix.lower() not in _SUFFIXES or (b"\0" in head and encoding_of(head) != "utf-16"):
        return False
    first = head.decode(encoding_of(head), "replace").splitlines()[:1]
    return bool(first) and first[0].count(delimiter_of(first[0])) >= 1


def _units_row(names: list[str], lines: list[str], delimiter: str) -> dict[str, str]:
    """Unit of each column, where the line below the names holds units and no numbers; else empty."""
    cells = [cell.strip().strip("[]()") for cell in next(csv.reader(lines, delimiter=delimiter, skipinitialspace=True), [])]
    said = [plain_unit(cell) for cell in cells]
    known = {unit for kind in FACTORS.values() for unit in kind if unit}
    if (
        len(cells) != len(names)
        or any(_is_number(cell) for cell in cells)
        or 2 * sum(unit in known for unit in said) < len(names)
    ):
        return {}
    return {name: unit for name, unit in zip(names, said, strict=True) if unit in known or unit in BUSHELS}


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """All rows. Raises InputError."""
    with path.open("rb") as stream:
        head = stream.read(1 << 16)
    encoding = encoding_of(head)
    lines = head.decode(encoding, "replace").splitlines()
    said_mark = _SEPARATOR.fullmatch(lines[0])
    if said_mark:
        lines = lines[1:] or [""]
    delimiter = said_mark[1] if said_mark else delimiter_of(lines[0])
    names = [name.strip() for name in next(csv.reader([lines[0]], delimiter=delimiter, skipinitialspace=True))]
    if twice := repeated(names):
        raise InputError(f"{path}: header", f"has {', '.join(sorted(twice))} more than once", "each column once")
    units = _units_row(names, lines[1:2], delimiter)
    columns, notes = columns_of(names, options.columns, units, str(path))
    place = {name: number for number, name in enumerate(names)}
    text_kinds = ("text", "date", "state")
    numbers = [place[c.name] for c in columns.values() if QUANTITIES[c.quantity].kind not in text_kinds]
    texts = [place[c.name] for c in columns.values() if QUANTITIES[c.quantity].kind in text_kinds]
    rows = rows_of(path, encoding, delimiter)
    for _ in range(1 + bool(units) + bool(said_mark)):
        next(rows, None)
    positions = [place[columns[q].name] for q in ("longitude", "latitude") if q in columns]
    sample = csv.reader(lines[1:-1] or lines[1:], delimiter=delimiter, skipinitialspace=True)
    degrees = [row[column] for row in sample for column in positions if column < len(row)]
    # With semicolons between fields, commas are within numbers.
    comma = delimiter == ";" or has_decimal_comma(degrees)
    table = read_rows(rows, numbers, texts, max([*numbers, *texts]) + 1, decimal_comma=comma)
    if not table.count:
        why = f" ({table.skipped[0].why})" if table.skipped else ""
        raise InputError(str(path), f"has a header and no row that can be read{why}", "at least one row")
    values = {names[n]: v for n, v in table.numbers.items()}
    if options.crs and "longitude" in columns and "latitude" in columns:
        east, north = columns["longitude"].name, columns["latitude"].name
        values[east], values[north], _ = to_degrees(values[east], values[north], None, options, str(path))
    raw = Raw(
        columns,
        values,
        {names[n]: v for n, v in table.texts.items()},
        table.count,
        table.skipped,
        notes,
        default_flow_s=DEFAULT_FLOW_S if _OF_A_RECORD.issubset(names) else 0.0,
    )
    return assemble(raw, str(path), KIND, options)
