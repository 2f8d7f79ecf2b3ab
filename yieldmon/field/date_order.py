"""Whether the day or the month comes first in a source's dates of three numbers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DateOrder:
    """day_first: as they are read. known: whether a date, the table or a person tells, so that it holds for other sources too.
    note: what is said of it."""

    day_first: bool
    known: bool
    note: str = ""
