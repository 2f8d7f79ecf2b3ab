"""One-second rows as CSV, JSON Lines or Parquet: the same rows give the same bytes.

Numbers are written in their shortest exact form, so nothing is lost and nothing depends on a width. What is not available is
an empty field in CSV and null elsewhere.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from typing import IO, Any, Protocol, get_args, get_type_hints

from yieldmon.errors import InputError
from yieldmon.files import arrow
from yieldmon.files.whole_file import scratch_for
from yieldmon.service.storage.rows import SecondRow

COLUMNS = tuple(field.name for field in dataclasses.fields(SecondRow))
FORMATS = (".csv", ".jsonl", ".parquet")
_values = attrgetter(*COLUMNS)


class RowWriter(Protocol):
    """Takes rows in order."""

    def write(self, row: SecondRow) -> None:
        """The next row."""

    def finish(self) -> None:
        """No more rows."""

    def abandon(self) -> None:
        """The table is not wanted any more; what is held open for it is let go."""


@contextmanager
def open_table(path: str, kind: str | None = None) -> Iterator[RowWriter]:
    """A writer for the file at `path`, which appears under its name when it is whole; "-" is standard output.

    kind: one of FORMATS; default: the path's suffix, for standard output ".csv". Raises InputError for another kind and
    for a path that cannot be a file's.
    """
    kind = kind or (".csv" if path == "-" else Path(path).suffix.lower())
    if kind not in FORMATS:
        raise InputError(path, f"unknown kind of table {kind!r}", f"a name that ends in one of {', '.join(FORMATS)}")
    if path == "-":
        writer = _writer(kind, sys.stdout, sys.stdout.buffer)
        yield writer
        writer.finish()
        return
    with scratch_for(path) as scratch, scratch.open("wb") as file:
        text = None if kind == ".parquet" else io.TextIOWrapper(file, encoding="utf-8", newline="")
        writer = _writer(kind, text, file)
        try:
            yield writer
        except BaseException:
            writer.abandon()
            raise
        writer.finish()
        if text is not None:
            text.flush()
            text.detach()


def _writer(kind: str, text: Any, binary: IO[bytes]) -> RowWriter:
    if kind == ".csv":
        return _CsvWriter(text)
    return _JsonLinesWriter(text) if kind == ".jsonl" else _ParquetWriter(binary)


class _CsvWriter:
    def __init__(self, file: IO[str]) -> None:
        self._writer = csv.writer(file, lineterminator="\n")
        self._writer.writerow(COLUMNS)

    def write(self, row: SecondRow) -> None:
        self._writer.writerow(_values(row))

    def finish(self) -> None:
        pass

    def abandon(self) -> None:
        pass


class _JsonLinesWriter:
    def __init__(self, file: IO[str]) -> None:
        self._file = file

    def write(self, row: SecondRow) -> None:
        self._file.write(json.dumps(dict(zip(COLUMNS, _values(row), strict=True)), separators=(",", ":"), allow_nan=False) + "\n")

    def finish(self) -> None:
        pass

    def abandon(self) -> None:
        pass


class _ParquetWriter:
    """Column by column, one row group for every few hours, so that a season needs little memory."""

    _ROWS = 20_000

    def __init__(self, file: IO[bytes]) -> None:
        import pyarrow
        import pyarrow.parquet

        arrow.without_pandas()
        types = {float: pyarrow.float64(), int: pyarrow.int64(), str: pyarrow.string()}
        hints = get_type_hints(SecondRow)
        kinds = {name: next(t for t in types if t in (hint, *get_args(hint))) for name, hint in hints.items()}
        self._schema = pyarrow.schema([(name, types[kinds[name]]) for name in COLUMNS])
        self._writer = pyarrow.parquet.ParquetWriter(file, self._schema)
        self._table = pyarrow.Table
        self._rows: list[dict[str, Any]] = []

    def write(self, row: SecondRow) -> None:
        self._rows.append(dict(zip(COLUMNS, _values(row), strict=True)))
        if len(self._rows) >= self._ROWS:
            self._flush()

    def finish(self) -> None:
        self._flush()
        self._writer.close()

    def abandon(self) -> None:
        self._writer.close()

    def _flush(self) -> None:
        self._writer.write_table(self._table.from_pylist(self._rows, schema=self._schema))
        self._rows = []
