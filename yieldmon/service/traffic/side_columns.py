"""Columns of a message's frames put together and picked apart, for `side_inputs`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.bulk import NOT_AVAILABLE, USABLE, MessageColumns, SignalColumn
from yieldmon.network.navigation_blocks import Column


def placed(values: NDArray[np.float64], at: NDArray[np.intp], size: int) -> SignalColumn:
    """A column of this size with the values at these places, and nothing available elsewhere."""
    column, status = np.full(size, np.nan), np.full(size, NOT_AVAILABLE, np.uint8)
    column[at], status[at] = values, USABLE
    return SignalColumn(column, status)


def taken_column(column: Column, wanted: NDArray[np.bool_]) -> Column:
    """The readings that are wanted."""
    return column if wanted.all() else Column(column.rows[wanted], column.time_s[wanted], column.values[wanted])


def taken(columns: MessageColumns, wanted: NDArray[np.bool_]) -> MessageColumns:
    """The frames that are wanted."""
    if wanted.all():
        return columns
    signals = {name: SignalColumn(column.values[wanted], column.status[wanted]) for name, column in columns.signals.items()}
    return MessageColumns(columns.name, columns.rows[wanted], columns.time_s[wanted], signals)


def merged(parts: Sequence[MessageColumns]) -> MessageColumns:
    """Frames of one message in the order of their rows; a signal that a part does not have is not available there."""
    if len(parts) == 1:
        return parts[0]
    rows = np.concatenate([part.rows for part in parts])
    order = np.argsort(rows, kind="stable")
    signals = {}
    for name in dict.fromkeys(name for part in parts for name in part.signals):
        columns = [part.signals.get(name) or _nothing(part.rows.size) for part in parts]
        values: NDArray[Any] = np.concatenate([column.values for column in columns])
        signals[name] = SignalColumn(values[order], np.concatenate([column.status for column in columns])[order])
    return MessageColumns(parts[0].name, rows[order], np.concatenate([part.time_s for part in parts])[order], signals)


def _nothing(size: int) -> SignalColumn:
    return SignalColumn(np.full(size, np.nan), np.full(size, NOT_AVAILABLE, np.uint8))
