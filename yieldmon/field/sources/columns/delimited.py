"""Rows of delimited text in blocks: numbers as arrays, texts as labels, rows that cannot be read counted and named."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from yieldmon import bounded
from yieldmon.errors import InputError
from yieldmon.field.table import Array, Label, Skipped
from yieldmon.files.delimited import plain_number

BLOCK_ROWS = 50_000
UNKNOWN = frozenset(
    {"", "-", "--", "---", "*", "**", "***", ".", "?", "na", "n/a", "#n/a", "#nv", "n.a.", "k.a.", "s/d", "nan", "null", "<null>",
     "(null)", "nil", "none", "nodata", "no data", "missing", "#div/0!", "#value!", "#wert!"}
)  # fmt: skip
"""What says that a value is not known, in lower case."""
_NAMED = 5
_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_THOUSANDS = {mark: re.compile(rf"[+-]?\d{{1,3}}(?:[{mark}]\d{{3}})+(?:[{sign}]\d*)?") for mark, sign in ((",", "."), (".", ","))}
"""Numbers with a mark between their thousands, by that mark."""
_SPACES = re.compile(r"(?<=\d)[ \u00a0\u202f'\u2019](?=\d{3}(?!\d))")


@dataclass(frozen=True)
class Rows:
    """Columns by number, and what could not be read."""

    numbers: Mapping[int, Array]
    texts: Mapping[int, Label]
    count: int
    skipped: tuple[Skipped, ...]


@dataclass
class _Bad:
    count: int = 0
    first: list[int] = field(default_factory=list)
    example: str = ""

    def add(self, row: int, example: str = "") -> None:
        self.count += 1
        self.example = self.example or example
        if len(self.first) < _NAMED:
            self.first.append(row)

    def skipped(self, why: str) -> tuple[Skipped, ...]:
        if not self.count:
            return ()
        more = f" and {self.count - len(self.first)} more" if self.count > len(self.first) else ""
        plural = "rows" if self.count > 1 else "row"
        example = f", such as {self.example[:40]!r}" if self.example else ""
        return (Skipped(f"{plural} {', '.join(map(str, self.first))}{more}", why + example),)


def encoding_of(head: bytes) -> str:
    """By the byte order mark; without one UTF-8, or Windows-1252 where most letters beyond ASCII are no UTF-8."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    text = head.decode("utf-8", "replace")
    wrong = text.count("\ufffd")
    return "cp1252" if wrong > sum(not letter.isascii() for letter in text) - wrong else "utf-8-sig"


def delimiter_of(line: str) -> str:
    """The most frequent of comma, semicolon, tab and bar outside quotes; commas that may be in each number are not counted."""
    plain = "".join(part for number, part in enumerate(line.split('"')) if number % 2 == 0)
    for mark in ";\t|":
        if plain.count(mark) >= 2 and plain.count(",") <= plain.count(mark) + 1:
            return mark
    return max(",;\t|", key=plain.count)


def has_decimal_comma(cells: Iterable[str]) -> bool:
    """Whether numbers are written with a comma: some are, and none with a point. cells: of columns of numbers, best of positions.

    >>> has_decimal_comma(["51,25", "12"]), has_decimal_comma(["1,250.5"]), has_decimal_comma(["51.25"])
    (True, False, False)
    """
    plain = [cell.strip() for cell in cells]
    return any(_COMMA.fullmatch(cell) for cell in plain) and not any("." in cell for cell in plain)


def rows_of(path: Path, encoding: str, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Number (from 1) and fields of each row that is not empty. Raises InputError for content without rows."""
    csv.field_size_limit(1 << 20)
    with path.open(encoding=encoding, errors="replace", newline="") as stream:
        lines = bounded.lines(stream, str(path), "a delimited text file")
        reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
        while True:
            try:
                row = next(reader)
            except StopIteration:
                return
            except csv.Error:
                yield reader.line_num, []
                continue
            except UnicodeError as error:
                raise InputError(str(path), f"is not text: {error}", "a delimited text file") from error
            if row and (len(row) > 1 or row[0].strip()):
                yield reader.line_num, row


def number(text: str) -> float:
    """A number, NaN for unknown. Raises ValueError."""
    plain = text.strip()
    return float("nan") if plain.lower() in UNKNOWN else plain_number(plain)


def numbers_in(texts: Sequence[str]) -> Array:
    """Numbers, also with decimal commas, (n,); NaN for any other text."""
    comma = has_decimal_comma(texts)
    out = np.full(len(texts), np.nan)
    for place, text in enumerate(texts):
        try:
            out[place] = number(text.replace(",", ".") if comma else text)
        except ValueError:
            continue
    return out


def read_rows(
    source: Iterator[tuple[int, list[str]]],
    numbers: Sequence[int],
    texts: Sequence[int],
    fields: int,
    decimal_comma: bool = False,
    pointed: Collection[int] = (),
    most: int | None = None,
) -> Rows:
    """The rows as columns.

    Parameters
    ----------
    source : iterator of (int, list of str)
        From rows_of.
    numbers, texts : sequence of int
        Columns wanted, from 0.
    fields : int
        Fewest fields that a row must have.
    decimal_comma : bool
        Whether numbers are written with a comma.
    pointed : collection of int
        Columns of which points part the thousands, see pointed_columns.
    most : int or None
        Most fields with a text that a row may have; None: any number.
    """
    arrays: dict[int, list[Array]] = {column: [] for column in numbers}
    labels = {column: _Labels(column) for column in texts}
    short, long, wrong = _Bad(), _Bad(), _Bad()
    count = 0
    while taken := _block(source, fields, short, most, long):
        block, values = _block_numbers(*taken, numbers, wrong, decimal_comma, pointed)
        count += len(block)
        for column in numbers:
            arrays[column].append(values[column])
        for label in labels.values():
            label.add(block)
    return Rows(
        {column: np.concatenate(parts) if parts else np.zeros(0) for column, parts in arrays.items()},
        {column: label.whole() for column, label in labels.items()},
        count,
        short.skipped(f"fewer than {fields} fields")
        + long.skipped(f"more than the {most} fields of its heading, as where a number or name has the comma that parts fields")
        + wrong.skipped("a field that is not a number"),
    )


def _block(
    source: Iterator[tuple[int, list[str]]], fields: int, short: _Bad, most: int | None, long: _Bad
) -> tuple[list[int], list[list[str]]] | None:
    """Numbers and fields of the next rows that have enough fields and not too many; None where there are no more."""
    lines: list[int] = []
    block: list[list[str]] = []
    line = None
    for line, row in islice(source, BLOCK_ROWS):
        if len(row) < fields:
            short.add(line)
        elif most is not None and len(row) > most and any(map(str.strip, row[most:])):
            long.add(line)
        else:
            lines.append(line)
            block.append(row)
    return None if line is None else (lines, block)


class _Labels:
    """A column of texts, block by block."""

    def __init__(self, column: int) -> None:
        self._column = column
        self._codes: list[Array] = []
        self._names: dict[str, int] = {}

    def add(self, block: Sequence[list[str]]) -> None:
        known, column = self._names, self._column
        texts = (" ".join(row[column].split()) if column < len(row) else "" for row in block)
        self._codes.append(np.fromiter((known.setdefault(text, len(known)) for text in texts), np.int32, len(block)))

    def whole(self) -> Label:
        codes = np.concatenate(self._codes).astype(np.int32) if self._codes else np.zeros(0, np.int32)
        return Label(codes, tuple(self._names) or ("",))


def _block_numbers(
    lines: list[int],
    block: list[list[str]],
    numbers: Sequence[int],
    wrong: _Bad,
    decimal_comma: bool,
    pointed: Collection[int],
) -> tuple[list[list[str]], dict[int, Array]]:
    """The rows whose wanted fields are numbers, and these by column. lines: number of each row."""

    def cell(row: list[str], column: int) -> str:
        text = row[column] if column < len(row) else ""
        if column in pointed and "." in text:
            # A number that does not fit is looked at below.
            text = text.replace(".", "") if _THOUSANDS["."].fullmatch(text.strip()) else "?"
        return text.replace(",", ".") if decimal_comma else text

    try:
        return block, {column: np.fromiter((float(cell(row, column)) for row in block), float, len(block)) for column in numbers}
    except ValueError:
        pass
    marks = {
        column: "."
        if column in pointed
        else _mark_of_thousands([row[column] for row in block if column < len(row)], decimal_comma)
        for column in numbers
    }

    def value(row: list[str], column: int) -> float:
        text = _SPACES.sub("", row[column].strip()) if column < len(row) else ""
        mark = marks[column]
        if mark and _THOUSANDS[mark].fullmatch(text):
            text = text.replace(mark, "")
        elif column in pointed and "." in text:
            raise ValueError(text)
        return number(text.replace(",", ".") if decimal_comma else text)

    good, values = [], []
    for line, row in zip(lines, block, strict=True):
        found: list[float] = []
        try:
            for column in numbers:
                found.append(value(row, column))
        except ValueError:
            wrong.add(line, row[numbers[len(found)]])
            continue
        values.append(found)
        good.append(row)
    table = np.array(values, dtype=float).reshape(len(values), len(numbers))
    return good, {column: table[:, place] for place, column in enumerate(numbers)}


def pointed_columns(rows: Sequence[Sequence[str]], columns: Sequence[int]) -> frozenset[int]:
    """Columns whose numbers have points between thousands only, in a file whose decimals are all written with commas.

    >>> sorted(pointed_columns([["48,1234567", "8.123"], ["48,1234569", "987"]], [0, 1]))
    [1]
    >>> sorted(pointed_columns([["48.1234567", "9.144", "8,5"], ["48.1234569", "9.144", "7,5"]], [0, 1, 2]))
    []
    """
    cells = {column: [row[column].strip() for row in rows if column < len(row)] for column in columns}
    decimals = [cell for found in cells.values() for cell in found if _COMMA.fullmatch(cell)]
    if not any(len(cell.split(",")[1]) != 3 for cell in decimals):
        return frozenset()
    with_points = {column: [cell for cell in found if "." in cell] for column, found in cells.items()}
    if not all(_THOUSANDS["."].fullmatch(cell) for found in with_points.values() for cell in found):
        return frozenset()
    return frozenset(column for column, found in with_points.items() if found)


def _mark_of_thousands(cells: Sequence[str], decimal_comma: bool) -> str:
    """The mark between the thousands of a column's numbers; empty where nothing tells that they have one.

    >>> _mark_of_thousands(["6,675.2", "987.0"], False), _mark_of_thousands(["7,123", "7,5"], False)
    (',', '')
    """
    mark, sign = (".", ",") if decimal_comma else (",", ".")
    marked = [cell.strip() for cell in cells if mark in cell]
    if not marked or not all(_THOUSANDS[mark].fullmatch(cell) for cell in marked):
        return ""
    return mark if any(sign in cell or cell.count(mark) > 1 for cell in cells) else ""
