"""Seconds that `yieldmon process` wrote as Parquet or JSON Lines; its CSV is read as any other."""

from __future__ import annotations

from pathlib import Path

from yieldmon import file_kinds
from yieldmon.field.table import HarvestTable
from yieldmon.service.logs import recorded

from .options import ReadOptions
from .store import table_of

KIND = "table that yieldmon process wrote"
ORDER = 25


def recognises(path: Path, head: bytes) -> bool:
    """A Parquet file, or JSON Lines by name."""
    return path.is_file() and (head.startswith(file_kinds.PARQUET) or path.suffix.lower() == ".jsonl")


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """All seconds; loads have numbers, and no field or crop. Raises InputError."""
    return table_of(recorded.read_seconds(path), {}, path, KIND, options)
