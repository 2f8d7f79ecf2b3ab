"""Which load a recorded second belongs to.

What comes between a load's end and the next one's begin carries the ended one's number and belongs to none.
"""

from __future__ import annotations

from collections.abc import Container, Iterable
from math import isclose

from yieldmon.service.storage.batch import Load
from yieldmon.service.storage.ledger import LoadRecord
from yieldmon.service.storage.rows import SecondRow

_ROUNDING = 1e-6


def between_loads(seconds: Iterable[SecondRow], loads: Iterable[Load | LoadRecord]) -> frozenset[int]:
    """Numbers of the seconds that belong to no load.

    A load's mass stands still once it has ended, which shows where its seconds end although the clock was set back meanwhile.
    Of seconds without mass the time decides.

    Parameters
    ----------
    seconds : iterable of SecondRow
        In order.
    loads : iterable of Load or LoadRecord
        One that has no end goes on.

    Returns
    -------
    frozenset of int
    """
    ends_s = {load.number: load.ended_s for load in loads if load.ended_s is not None}
    found = list[int]()
    before: SecondRow | None = None
    for second in seconds:
        if second.load_number in ends_s and _is_between(second, before, ends_s[second.load_number]):
            found.append(second.number)
        before = second
    return frozenset(found)


def _is_between(second: SecondRow, before: SecondRow | None, ended_s: float) -> bool:
    """Whether a second came after the end of the load whose number it has. before: the second read before it."""
    if second.mass_kg > 0.0 and second.load_kg > 0.0:
        follows = before is not None and (before.number, before.load_number) == (second.number - 1, second.load_number)
        before_kg = before.load_kg if before is not None and follows else 0.0
        if isclose(second.load_kg - before_kg, second.mass_kg, rel_tol=_ROUNDING):
            return False
        if follows and second.load_kg == before_kg:
            return True
    return bool(second.time_s > ended_s)


def load_of(second: SecondRow, between: Container[int]) -> int | None:
    """Number of the load that a second belongs to; None for one between loads. between: as `between_loads` has it."""
    return None if second.number in between else int(second.load_number)
