"""Decoded columns as the codec's frames, for tests that hold one against the other."""

from __future__ import annotations

from yieldmon.bus.bulk import ERROR, NOT_AVAILABLE, USABLE, MessageColumns
from yieldmon.frames import Frame, Unusable

_UNUSABLE = {NOT_AVAILABLE: Unusable.NOT_AVAILABLE, ERROR: Unusable.ERROR}


def frames_of(columns: MessageColumns) -> list[Frame]:
    """The rows as Codec.decode() gives them, one Frame each."""
    values = {
        name: [
            value if status == USABLE else _UNUSABLE[status]
            for value, status in zip(column.values.tolist(), column.status.tolist(), strict=True)
        ]
        for name, column in columns.signals.items()
    }
    return [
        Frame(time_s, columns.name, {name: column[row] for name, column in values.items()})
        for row, time_s in enumerate(columns.time_s.tolist())
    ]
