"""What a reader found in a file, before units, clocks and names are settled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from yieldmon.field.table import Array, Label, Skipped

from .naming import Column


@dataclass(frozen=True)
class Raw:
    """What a file holds.

    Parameters
    ----------
    columns : mapping of str to Column
        By quantity.
    numbers, texts : mapping of str to array or Label
        By the file's own name.
    count : int
        Rows.
    skipped, notes
        As in Source.
    default_flow_s : float
        See HarvestTable.
    """

    columns: Mapping[str, Column]
    numbers: Mapping[str, Array]
    texts: Mapping[str, Label]
    count: int
    skipped: tuple[Skipped, ...] = ()
    notes: tuple[str, ...] = ()
    default_flow_s: float = 0.0
