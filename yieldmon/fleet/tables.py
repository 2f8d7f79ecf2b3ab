"""Tables of a partition beside its records: columns declared once, written as Parquet.

Times are bus time, s. The partition's machine and day stand in its folder's name (machine=NAME/day=NAME), as DuckDB, Spark and
pyarrow read them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from yieldmon.files import arrow

if TYPE_CHECKING:
    import pyarrow as pa

RECORDS = "records"
LOADS, SWEEPS, FAULTS, PARAMETERS, PROVENANCE = "loads", "sweeps", "faults", "parameters", "provenance"
TABLES = (RECORDS, LOADS, SWEEPS, FAULTS, PARAMETERS, PROVENANCE)

LOG, TICKET, LOAD = "log", "ticket", "load"
"""Kinds of rows in the table of loads: what a log holds, what a ticket covers, what the engine counted as one load."""

_COLUMNS: Mapping[str, Mapping[str, str]] = {
    LOADS: {
        "kind": "string", "name": "string", "first_number": "int64", "last_number": "int64", "start_s": "float64",
        "end_s": "float64", "seconds": "int64", "measured_kg": "float64", "std_dev_kg": "float64", "complete": "bool",
        "weighed_kg": "float64", "weighed_std_dev_kg": "float64", "other_monitor_std_dev_kg": "float64",
        "logs": "string",
    },
    SWEEPS: {
        "sweep_id": "int64", "time_s": "float64", "state": "string", "reason": "string", "angles_deg": "string",
        "parameter_version": "int64",
    },
    FAULTS: {"code": "string", "begin_s": "float64", "end_s": "float64", "detail": "string"},
    PARAMETERS: {
        "time_s": "float64", "version": "int64", "origin": "string", "reason": "string", "name": "string", "value": "float64",
        "std_dev": "float64",
    },
    PROVENANCE: {
        "key": "string", "software_version": "string", "source_sha256": "string", "libraries": "string",
        "parameters_sha256": "string", "inputs_sha256": "string", "crop": "string", "logs": "string", "poisoned": "string",
        "damages": "string", "frames": "int64", "frames_of_ours": "int64", "frames_malformed": "int64", "seconds": "int64",
        "total_mass_kg": "float64", "dry_mass_kg": "float64", "zero_known": "bool", "machine_document": "string",
        "parameters_document": "string",
    },
}  # fmt: skip


def write(table: str, rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write rows; a column that a row lacks is null. The same rows give the same bytes."""
    import pyarrow as pa
    from pyarrow import parquet

    arrow.without_pandas()
    made = pa.Table.from_pylist([dict(row) for row in rows], schema=_schema(table))
    parquet.write_table(made, path)


def _schema(table: str) -> pa.Schema:
    import pyarrow as pa

    kinds = {"string": pa.string(), "int64": pa.int64(), "float64": pa.float64(), "bool": pa.bool_()}
    return pa.schema([(name, kinds[kind]) for name, kind in _COLUMNS[table].items()])
