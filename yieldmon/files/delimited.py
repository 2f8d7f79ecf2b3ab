"""Tables as people save them: commas, semicolons or tabs, decimal commas, a byte-order mark, Excel workbooks.

What is read is the same in each: a header of names in lower case, rows of texts with a point as decimal sign, and the line of the
file that each row stands on.
"""

from __future__ import annotations

import csv
import hashlib
import io
import logging
import re
import warnings
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yieldmon import bounded
from yieldmon.errors import InputError, brief
from yieldmon.file_kinds import kind_of
from yieldmon.repeats import repeated

_log = logging.getLogger(__name__)

UNKNOWN = ("", "-", "nan", "na", "n/a", "null")
"""Cells that say "not known", in lower case."""
WORKBOOK = ".xlsx"
LARGEST_BYTES = 256_000_000
"""Of a table; its cells take ten times as much memory."""
_ZIP = b"PK\x03\x04"
#: What a file is -> what would do; a CSV file for all others.
_EXPECTED = {
    "compressed": "a plain CSV file; gunzip it",
    "an old Excel file": f"a CSV file, or the workbook saved as *{WORKBOOK}",
    "an OpenDocument file": f"a CSV file, or the workbook saved as *{WORKBOOK}",
    "a database, as a daemon's store is": "a table; of a store: `calibrate --loads STORE` takes its loads, "
    "`diagnose STORE --table FILE` its sweeps",
}
_SEPARATORS = ",;\t"
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")


@dataclass(frozen=True)
class TextTable:
    """header: names in lower case, each once. rows: as many texts each. lines: of the file, from 1. notes: what was taken for
    what."""

    path: str
    sha256: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    notes: tuple[str, ...] = ()

    def column(self, name: str) -> tuple[str, ...]:
        """The cells of a column."""
        place = self.header.index(name)
        return tuple(row[place] for row in self.rows)

    def where(self, row: int, column: str = "") -> str:
        """The place of a cell (row from 0), as an error names it."""
        return f"{self.path}: line {self.lines[row]}" + (f", {column}" if column else "")


def is_unknown(cell: str) -> bool:
    """Whether a cell says that its value is not known."""
    return cell.lower() in UNKNOWN


def plain_number(cell: str) -> float:
    """A number as tables hold it, without the separator of digits that Python's own numbers may have. Raises ValueError."""
    return float(cell if "_" not in cell else "")


def read(path: str | Path) -> TextTable:
    """A table with a header line; empty lines and lines that begin with # are passed over. Raises InputError."""
    where = str(path)
    raw = bounded.read_whole(path, "a readable CSV file", LARGEST_BYTES)
    cells = _workbook(raw, where) if raw.startswith(_ZIP) else _separated(raw, where)
    if not cells:
        raise InputError(where, "is empty", "a header line and rows")
    names = tuple(name.strip() for name in cells[0][1])
    header = tuple(name.lower() for name in names)
    if repeats := repeated(header):
        twice = sorted(name for name in repeats if name)
        if not twice:
            title = f"line {cells[0][0]} lacks {header.count('')} of {len(header)} columns' names"
            raise InputError(f"{where}: header", title, "a name for each column; remove a title above them and merged cells")
        raise InputError(f"{where}: header", f"has {', '.join(twice)} more than once", "each column once")
    body = cells[1:]
    if not body:
        raise InputError(where, "has a header and no rows", "at least one row")
    for line, row in body:
        if len(row) != len(header):
            raise InputError(
                f"{where}: line {line}",
                f"has {len(row)} fields",
                f"{len(header)}, as in the header" + _comma_hint(row, len(header)),
            )
    return TextTable(
        where,
        hashlib.sha256(raw).hexdigest(),
        header,
        tuple(tuple(c.strip() for c in row) for _, row in body),
        tuple(line for line, _ in body),
    )


def _comma_hint(row: list[str], wanted: int) -> str:
    if wanted == 1:
        return " (a title above the columns' names goes)"
    return " (decimal commas? then separate the columns by semicolons)" if len(row) > wanted else ""


def _separated(raw: bytes, where: str) -> list[tuple[int, list[str]]]:
    text = _text(raw, where)
    first = next(
        (line for line in bounded.split(text, where, "a plain CSV file") if line.strip() and not line.startswith("#")), ""
    )
    separator = max(_SEPARATORS, key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    found: list[tuple[int, list[str]]] = []
    try:
        for row in reader:
            if any(cell.strip() for cell in row) and not row[0].startswith("#"):
                found.append((reader.line_num, row))
    except csv.Error as error:
        raise InputError(f"{where}: line {reader.line_num}", f"not CSV: {error}", "a plain CSV file") from error
    if separator == ",":
        return found
    return [(line, [_point(cell) for cell in row]) for line, row in found]


def _point(cell: str) -> str:
    """A decimal comma as a point."""
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell.strip()) else cell


def _text(raw: bytes, where: str) -> str:
    if kind := kind_of(raw):
        raise InputError(where, f"is {kind}", _EXPECTED.get(kind, "a UTF-8 CSV file"))
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(where, f"byte {error.start} is not UTF-8", "a UTF-8 CSV file") from error


def workbook_sheets(path: str | Path) -> list[tuple[str, list[tuple[int, list[str]]]]]:
    """Name of each sheet of a workbook, and line and cells of each of its rows that is not empty. Raises InputError."""
    return _sheets(bounded.read_whole(path, "a workbook", LARGEST_BYTES), str(path))


def _workbook(raw: bytes, where: str) -> list[tuple[int, list[str]]]:
    """The first sheet with cells; warns of others. Raises ModuleNotFoundError without openpyxl."""
    filled = [(name, cells) for name, cells in _sheets(raw, where) if cells]
    if not filled:
        return []
    (read_here, cells), *others = filled
    if others:
        left = brief(", ".join(name for name, _ in others))
        _log.warning("%s: of its sheets %s is read; not read: %s", where, read_here, left)
    return cells


def _sheets(raw: bytes, where: str) -> list[tuple[str, list[tuple[int, list[str]]]]]:
    """Sheets by name. Raises ModuleNotFoundError without openpyxl."""
    # An extra: most tables are text.
    import openpyxl

    expected = f"a CSV file or a workbook (*{WORKBOOK})"
    with warnings.catch_warnings():
        # Of styles and links, which say nothing about the cells.
        warnings.simplefilter("ignore")
        try:
            unpacked = sum(part.file_size for part in zipfile.ZipFile(io.BytesIO(raw)).infolist())
            if unpacked > LARGEST_BYTES:
                raise InputError(where, f"unpacks to {unpacked / 1e6:.0f} MB", f"at most {LARGEST_BYTES / 1e6:.0f} MB")
            book = openpyxl.load_workbook(io.BytesIO(raw), read_only=True, data_only=True)
        except InputError:
            raise
        except Exception as error:
            raise InputError(where, "is a zip archive and no Excel workbook", expected) from error
        found = []
        for sheet in book.worksheets:
            try:
                rows = [[_cell(value) for value in row] for row in sheet.iter_rows(values_only=True)]
            except Exception as error:  # openpyxl raises anything on a damaged sheet
                raise InputError(where, f"has a sheet that cannot be read: {brief(error)}", expected) from error
            found.append((str(sheet.title), _filled_rows(rows)))
    if not found:
        raise InputError(where, "is a workbook without a sheet of cells", expected)
    return found


def _filled_rows(rows: list[list[str]]) -> list[tuple[int, list[str]]]:
    """Line and cells of rows that are neither empty nor remarks, all as wide as the widest."""
    width = max((len(row) - next((i for i, c in enumerate(reversed(row)) if c), len(row)) for row in rows), default=0)
    cells = [(i, (row + [""] * width)[:width]) for i, row in enumerate(rows, 1)]
    return [(line, row) for line, row in cells if any(row) and not row[0].startswith("#")]


def _cell(value: Any) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else str(value).strip()
