"""What a reader found in a file, before units, clocks and names are settled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
    decimal_comma : bool
        Whether decimals have commas.
    """

    columns: Mapping[str, Column]
    numbers: Mapping[str, Array]
    texts: Mapping[str, Label]
    count: int
    skipped: tuple[Skipped, ...] = ()
    notes: tuple[str, ...] = ()
    default_flow_s: float = 0.0
    decimal_comma: bool = False

    @property
    def machine_of_row(self) -> NDArray[np.int32]:
        """Number of the machine that made each row, (count,): one of several follows rows of its own."""
        column = self.columns.get("machine")
        label = None if column is None else self.texts.get(column.name)
        return np.zeros(self.count, np.int32) if label is None else label.codes
