"""Loads in which nothing was measured: begun and ended at once, or left by a restart.

Lists leave them out, the store keeps them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from yieldmon.documents.loads import ListedLoad

if TYPE_CHECKING:
    from yieldmon.service.storage.batch import Load
    from yieldmon.service.storage.ledger import LoadRecord


def empty_loads(loads: Iterable[Load | LoadRecord]) -> list[int]:
    """Numbers of the complete loads without grain.

    A load before the newest is complete, also where the bus gave no time for its end.
    """
    known = sorted(loads, key=lambda load: load.number)
    return [load.number for load in known if not load.mass_kg > 0.0 and (load.ended_s is not None or load is not known[-1])]


def without_empty(rows: Sequence[ListedLoad], empty: Iterable[int]) -> list[ListedLoad]:
    """The rows of the other loads."""
    left_out = frozenset(empty)
    return [row for row in rows if row["number"] not in left_out]


def not_listed(count: int) -> str:
    """What a list says of the loads that it leaves out.

    >>> not_listed(1)
    '1 empty load not listed; --all lists it'
    """
    return f"{count} empty loads not listed; --all lists them" if count > 1 else "1 empty load not listed; --all lists it"
