"""CSV with a header, or a sheet of a workbook, columns found by names that say their unit or by a column map."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from yieldmon.errors import InputError, brief
from yieldmon.field.table import DEFAULT_FLOW_S, Array, HarvestTable, Skipped, joined
from yieldmon.field.units import factor
from yieldmon.files import delimited as workbooks

from .columns import heads, written_places
from .columns.assembled import assemble
from .columns.coordinates import MEND, mostly_degrees, to_degrees
from .columns.delimited import encoding_of, has_decimal_comma, numbers_in, pointed_columns, read_rows, rows_of
from .columns.naming import QUANTITIES, Column, columns_of, plain_name, split_unit
from .columns.raw_table import Raw
from .options import ReadOptions

KIND = "CSV with a header, or workbook"
ORDER = 60
_SUFFIXES = (".csv", ".txt", ".tsv")
_LOOKED_AT = 2_000
_OF_A_RECORD = frozenset({"time_s", "mass_flow_kg_s", "load_number", "zero_mv", "usable_for_calibration"})
"""Columns of a table of `yieldmon process` or `export`, whose places are those of the machine: the delay is still in it."""
_MASS_OF_A_RECORD = frozenset({"mass_kg", "duration_s"})


def recognises(path: Path, head: bytes) -> bool:
    """By its suffix, where it is text with a header, or a workbook."""
    if path.is_dir():
        return False
    if path.suffix.lower() == workbooks.WORKBOOK:
        return head.startswith(b"PK\x03\x04")
    if path.suffix.lower() not in _SUFFIXES or (b"\0" in head and encoding_of(head) != "utf-16"):
        return False
    return heads.looks_like_one(head.decode(encoding_of(head), "replace"))


@dataclass(frozen=True)
class _Table:
    """rows: below the head, with their line. sample: cells of some of them. comma: whether decimals have commas, None where
    the cells tell."""

    head: heads.Head
    rows: Iterator[tuple[int, list[str]]]
    sample: Sequence[Sequence[str]]
    comma: bool | None


def _text(path: Path, options: ReadOptions) -> _Table:
    with path.open("rb") as stream:
        raw = stream.read(1 << 16)
    encoding = encoding_of(raw)
    lines = raw.decode(encoding, "replace").splitlines()
    head = heads.of_text(lines, [name for name, _ in options.columns.values()])
    rows = ((line, row) for line, row in rows_of(path, encoding, head.delimiter) if line > head.above)
    below = lines[head.above : -1] or lines[head.above :]
    sample = list(csv.reader(below, delimiter=head.delimiter, skipinitialspace=True))
    # With semicolons between fields, commas are within numbers.
    return _Table(head, rows, sample, True if head.delimiter == ";" else None)


def _sheet(cells: list[tuple[int, list[str]]], options: ReadOptions) -> _Table:
    rows = [row for _, row in cells]
    at = heads.header_among(rows, [name for name, _ in options.columns.values()])
    head = heads.of_cells(rows[at : at + 2], at)
    return _Table(head, iter(cells[head.above :]), rows[head.above :][:_LOOKED_AT], None)


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """All rows, of a workbook those of all sheets that are harvests. Raises InputError."""
    if path.suffix.lower() != workbooks.WORKBOOK:
        return _read(_text(path, options), str(path), options)
    sheets = [(name, cells) for name, cells in workbooks.workbook_sheets(path) if cells]
    if not sheets:
        raise InputError(str(path), "is empty", "a sheet with a header and rows")
    tables, skipped = [], []
    first: InputError | None = None
    for name, cells in sheets:
        where = str(path) if len(sheets) == 1 else f"{path}: sheet {name}"
        try:
            tables.append(_read(_sheet(cells, options), where, options))
        except InputError as error:
            first = first or error
            skipped.append(Skipped(f"sheet {brief(name)}", error.problem))
    if not tables and first is not None:
        raise first
    return joined(tables).noting(skipped=skipped)


def _read(found: _Table, where: str, options: ReadOptions) -> HarvestTable:
    """The rows of a text or sheet. Raises InputError."""
    heads.require_each_once(found.head.names, where)
    found = _with_places(found)
    names = found.head.names
    given = dict(options.columns)
    record = _OF_A_RECORD.issubset(names)
    if record and _MASS_OF_A_RECORD.issubset(names):
        given.setdefault("mass", ("mass_kg", "kg"))
    place = {name: number for number, name in enumerate(names)}
    columns, notes = columns_of(
        names,
        given,
        found.head.units,
        where,
        width_known=options.width_m is not None,
        numbers_of=lambda name: numbers_in([row[place[name]] if place[name] < len(row) else "" for row in found.sample]),
    )
    text_kinds = ("text", "date", "state")
    numbers = [place[c.name] for c in columns.values() if QUANTITIES[c.quantity].kind not in text_kinds]
    texts = [place[c.name] for c in columns.values() if QUANTITIES[c.quantity].kind in text_kinds]
    positions = [place[columns[q].name] for q in ("longitude", "latitude") if q in columns]
    comma = found.comma
    if comma is None:
        comma = has_decimal_comma(cell for row in found.sample for cell in _cells(row, positions))
    pointed = pointed_columns(found.sample, numbers) if comma else frozenset()
    rows = heads.without_headers(found.rows, names, where)
    if any(written_places.degrees(cell) != cell for row in found.sample for cell in _cells(row, positions)):
        rows = written_places.with_degrees(rows, positions)
    most = min((len(row) for row in found.sample if len(row) >= len(names)), default=len(names))
    table = read_rows(rows, numbers, texts, max([*numbers, *texts]) + 1, comma, pointed, most)
    if most > len(names) and any(any(map(str.strip, row[len(names) :])) for row in found.sample):
        notes = (*notes, f"rows have {most} fields and the heading {len(names)}: those beyond it are not used")
    if not table.count:
        why = f" ({table.skipped[0].why})" if table.skipped else ""
        raise InputError(where, f"has a header and no row that can be read{why}", "at least one row")
    values = {names[n]: v for n, v in table.numbers.items()}
    of_places = places_in_degrees(values, columns, options, where)
    raw = Raw(
        columns,
        values,
        {names[n]: v for n, v in table.texts.items()},
        table.count,
        table.skipped,
        (*notes, *of_places),
        default_flow_s=DEFAULT_FLOW_S if record else 0.0,
        decimal_comma=comma,
    )
    return assemble(raw, where, KIND, options)


def _cells(row: Sequence[str], columns: Sequence[int]) -> list[str]:
    """The cells that a row has in some columns."""
    return [row[column] for column in columns if column < len(row)]


def _with_places(found: _Table) -> _Table:
    """With columns of longitude and latitude where the table has them as points in well-known text."""
    names = found.head.names
    if any(plain_name(split_unit(name)[0]) in QUANTITIES["longitude"].names for name in names):
        return found
    column = written_places.column_of_points(names, found.sample)
    if column is None:
        return found
    head = replace(found.head, names=[*names, "longitude", "latitude"])
    return replace(found, head=head, rows=written_places.with_coordinates(found.rows, column, len(names)))


def places_in_degrees(values: dict[str, Array], columns: dict[str, Column], options: ReadOptions, where: str) -> tuple[str, ...]:
    """Changes coordinates of a plane; notes. Raises InputError where it is not said of which.

    Parameters
    ----------
    values : dict of str to array, shape (n,)
        By column; changed.
    columns : dict of str to Column
        By quantity.
    options : ReadOptions
    where : str
        Place for errors.
    """
    if not {"longitude", "latitude"} <= columns.keys():
        return ()
    east, north = columns["longitude"].name, columns["latitude"].name
    angles = [columns[one] for one in ("longitude", "latitude")]
    if any(one.unit and factor(one.unit, "angle", f"{where}: {one.name}") != 1.0 for one in angles):
        return ()
    mend = f"{MEND}, or a unit, such as --column longitude={east}:1e-7deg"
    if options.crs or mostly_degrees(values[east], values[north]) is False:
        values[east], values[north], notes = to_degrees(values[east], values[north], None, options, where, mend)
        return notes
    return ()
