"""Which load a recorded second belongs to.

What comes between a load's end and the next one's begin carries the ended one's number and belongs to none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import inf

from yieldmon.service.storage.batch import Load
from yieldmon.service.storage.ledger import LoadRecord
from yieldmon.service.storage.rows import SecondRow


def load_ends_s(loads: Iterable[Load | LoadRecord]) -> dict[int, float]:
    """When the loads ended that have, Unix time, by number."""
    return {load.number: load.ended_s for load in loads if load.ended_s is not None}


def load_of(row: SecondRow, ends_s: Mapping[int, float]) -> int | None:
    """Number of the load that a second belongs to; None for grain between loads. ends_s: as `load_ends_s` has them."""
    number = int(row.load_number)
    return number if row.time_s <= ends_s.get(number, inf) else None
