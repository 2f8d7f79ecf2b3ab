"""A request of an operator, and what it is carried out on."""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.errors import InputError
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.request_context import RequestContext
from yieldmon.service.operator.requests import Request
from yieldmon.service.storage.batch import Load


@dataclass(frozen=True, slots=True, kw_only=True)
class Order(RequestContext):
    """A request and what it is carried out on."""

    request: Request


def covered_loads(journal: Journal, first: int, last: int, what: str = "ticket for load") -> list[Load]:
    """The loads from one number to another.

    Parameters
    ----------
    journal : Journal
    first, last : int
        Numbers of loads.
    what : str
        Names them in an error.

    Returns
    -------
    list of Load
        Those that there are, by number.

    Raises
    ------
    InputError
        Where there is no load of either number, or the last is below the first.
    """
    loads = {load.number: load for load in journal.loads}
    for number in (first, last):
        if number not in loads:
            known = f"{min(loads)} to {max(loads)}" if loads else "a load that was measured"
            raise InputError(f"{what} {number}", "no such load", known)
    if last < first:
        raise InputError(f"{what}s {first} to {last}", "the last number is below the first", "the first load first")
    return [loads[number] for number in sorted(loads) if first <= number <= last]
