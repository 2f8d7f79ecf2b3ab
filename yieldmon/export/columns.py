"""Dataclass rows as CSV or Parquet: what is not known is an empty field or null."""

from __future__ import annotations

import csv
import dataclasses
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from yieldmon.files import arrow
from yieldmon.files.plain_text import cell
from yieldmon.files.whole_file import scratch_for


def write_csv(path: Path, kind: type, rows: Sequence[Any]) -> None:
    """Numbers in their shortest exact form. kind: the dataclass of the rows."""
    with scratch_for(path) as scratch, scratch.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(field.name for field in dataclasses.fields(kind))
        writer.writerows(map(_cells, rows))


def _cells(row: Any) -> list[Any]:
    return [cell(value) if isinstance(value, str) else value for value in dataclasses.astuple(row)]


def write_parquet(path: Path, kind: type, rows: Sequence[Any]) -> None:
    """Needs pyarrow (the `parquet` extra)."""
    import pyarrow
    import pyarrow.parquet

    arrow.without_pandas()
    types = {bool: pyarrow.bool_(), float: pyarrow.float64(), int: pyarrow.int64(), str: pyarrow.string()}
    schema = pyarrow.schema(
        [
            (name, next(types[one] for one in types if one in (hint, *typing.get_args(hint))))
            for name, hint in typing.get_type_hints(kind).items()
        ]
    )
    table = pyarrow.Table.from_pylist([dataclasses.asdict(row) for row in rows], schema=schema)
    with scratch_for(path) as scratch:
        pyarrow.parquet.write_table(table, scratch)
