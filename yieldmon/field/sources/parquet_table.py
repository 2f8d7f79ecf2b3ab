"""Parquet of other programs: GeoParquet, or a table with columns of longitude and latitude, such as one of `yieldmon export`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from yieldmon import file_kinds
from yieldmon.errors import InputError, brief
from yieldmon.field.table import HarvestTable

from . import vector
from .columns.assembled import assemble
from .columns.naming import columns_of
from .columns.raw_table import Raw
from .csv_table import places_in_degrees
from .options import ReadOptions

KIND = "Parquet"
ORDER = 24
_OF_PROCESS = frozenset({"number", "mass_flow_kg_s"})
"""Columns of `yieldmon process`, whose tables are read as stores are."""
_UNSAID_CRS = "OGC:CRS84"


def recognises(path: Path, head: bytes) -> bool:
    """A Parquet file that `yieldmon process` did not write."""
    if not path.is_file() or not head.startswith(file_kinds.PARQUET):
        return False
    import pyarrow
    import pyarrow.parquet

    try:
        return not _OF_PROCESS.issubset(pyarrow.parquet.read_schema(path).names)
    except (pyarrow.ArrowException, OSError, ValueError):
        return False


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """All rows. Raises InputError where they are no harvest."""
    where = str(path)
    fields, geo = _content(path)
    if not fields or not len(next(iter(fields.values()))):
        raise InputError(where, "has no rows", "at least one")
    geometry = geo.get("primary_column")
    if geometry is None:
        width_known, numbers_of = options.width_m is not None, vector.first_numbers(fields)
        found, notes = columns_of(tuple(fields), options.columns, {}, where, width_known=width_known, numbers_of=numbers_of)
        columns, numbers, texts, unreadable = vector.values_of(found, fields)
        notes += unreadable + places_in_degrees(numbers, columns, options, where)
        count = len(next(iter(fields.values())))
        return assemble(Raw(columns, numbers, texts, count, notes=notes), where, KIND, options)
    said = dict(geo.get("columns", {}).get(geometry, {}))
    if said.get("encoding") != "WKB" or geometry not in fields:
        raise InputError(where, f"has places as {str(said.get('encoding'))[:40]}", "GeoParquet with places as WKB")
    shapes = fields.pop(geometry)
    crs = json.dumps(said["crs"]) if said.get("crs") else _UNSAID_CRS
    return vector.table_of(vector.layer_of(shapes, fields, crs, where), vector.Metadata({}), where, KIND, options)


def _content(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Values of each column that has one a row, and what GeoParquet says of the places."""
    import pyarrow
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(path)
        plain = [name for name in table.column_names if not pyarrow.types.is_nested(table.column(name).type)]
        geo = json.loads((table.schema.metadata or {}).get(b"geo", b"{}"))
        return {name: _values(table.column(name)) for name in plain}, geo if isinstance(geo, dict) else {}
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise InputError(str(path), f"cannot be read: {brief(error)}", "a Parquet file") from error


def _values(column: Any) -> np.ndarray:
    """Numbers, datetimes, texts or bytes."""
    import pyarrow

    kind = column.type
    if pyarrow.types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    if pyarrow.types.is_decimal(kind):
        column = column.cast(pyarrow.float64())
    if pyarrow.types.is_date(kind):
        column = column.cast(pyarrow.timestamp("ms"))
    values: np.ndarray = column.to_numpy()
    return values
