"""Where a table's header is: below a title, remarks or the line of the separator; and the line of units below it."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from yieldmon.errors import InputError
from yieldmon.field.units import BUSHELS, FACTORS, plain_unit
from yieldmon.repeats import repeated

from .delimited import delimiter_of
from .naming import is_known_name

SEPARATOR = re.compile(r"sep=([,;\t|])\s*", re.IGNORECASE)
"""What spreadsheets write above the header."""
_LOOKED_AT = 40
_LEAST_KNOWN = 3
"""Names of quantities that make a line a header."""


@dataclass(frozen=True)
class Head:
    """names: of the columns. units: by name, from the line below. above: lines before the first row. delimiter: of text."""

    names: list[str]
    units: dict[str, str]
    above: int
    delimiter: str = ","


def of_text(lines: Sequence[str], given: Collection[str]) -> Head:
    """The head of delimited text. given: names of columns by a person, which are in the header as well."""
    said = SEPARATOR.fullmatch(lines[0]) if lines else None
    first = 1 if said else 0
    found = first
    for number, line in enumerate(lines[first : first + _LOOKED_AT], first):
        if line.strip() and _is_header(_cells(line, said[1] if said else delimiter_of(line)), given):
            found = number
            break
    header = lines[found] if found < len(lines) else ""
    delimiter = said[1] if said else delimiter_of(header)
    return of_cells([_cells(line, delimiter) for line in lines[found : found + 2]], found, delimiter)


def of_cells(rows: Sequence[Sequence[str]], above: int, delimiter: str = ",") -> Head:
    """The head of which these are the lines. above: lines before them."""
    names = [cell.strip() for cell in rows[0]] if rows else []
    units = _units(names, rows[1]) if len(rows) > 1 else {}
    return Head(names, units, above + 1 + bool(units), delimiter)


def header_among(rows: Sequence[Sequence[str]], given: Collection[str]) -> int:
    """Number of the row that is the header, the first one where none looks like one."""
    return next((number for number, row in enumerate(rows[:_LOOKED_AT]) if _is_header(row, given)), 0)


def looks_like_one(text: str) -> bool:
    """Whether text has a header in its first lines, or a first line of several names."""
    lines = text.splitlines()[:_LOOKED_AT]
    return bool(lines) and (
        lines[0].count(delimiter_of(lines[0])) >= 1
        or any(_is_header(_cells(line, delimiter_of(line)), ()) for line in lines if line.strip())
    )


def without_headers(rows: Iterator[tuple[int, list[str]]], names: Sequence[str], where: str) -> Iterator[tuple[int, list[str]]]:
    """Rows without headers that stand among them, as where files were put one behind another.

    Raises
    ------
    InputError
        For a header of other columns.
    """
    known = set(names)
    for line, row in rows:
        if row[0].strip() in known or row[-1].strip() in known:
            cells = [cell.strip() for cell in row]
            if cells == list(names):
                continue
            if _is_header(cells, ()):
                raise InputError(f"{where}: line {line}", "is another header, of other columns", "a file for each header")
        yield line, row


def require_each_once(names: Sequence[str], where: str) -> None:
    """Raises InputError for a name that two columns have."""
    if twice := repeated([name for name in names if name]):
        raise InputError(f"{where}: header", f"has {', '.join(sorted(twice))} more than once", "each column once")


def _cells(line: str, delimiter: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return []


def _is_header(cells: Sequence[str], given: Collection[str]) -> bool:
    named = [cell.strip() for cell in cells]
    if any(_is_number(cell) for cell in named):
        return False
    return sum(is_known_name(cell) or cell in given for cell in named if cell) >= _LEAST_KNOWN


def _units(names: Sequence[str], below: Sequence[str]) -> dict[str, str]:
    """Unit of each column, where the line below the names holds units and no numbers; else empty."""
    cells = [cell.strip().strip("[]()") for cell in below]
    said = [plain_unit(cell) for cell in cells]
    known = {unit for kind in FACTORS.values() for unit in kind if unit} | set(BUSHELS)
    written = [unit for unit in said if unit]
    if (
        len(cells) != len(names)
        or any(_is_number(cell) for cell in cells)
        or len(written) < 2
        or 2 * sum(unit in known for unit in written) < len(written)
    ):
        return {}
    return {name: unit for name, unit in zip(names, said, strict=True) if unit in known}


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True
