"""Each load on one ticket: weighings of a load in parts are added where their table says so, and refused where it does not."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import replace
from math import sqrt
from typing import TypeVar

from yieldmon.errors import InputError

from .ticket_file import WeighedTicket

Load = TypeVar("Load", bound=Hashable)
ONE_ROW = "one row for each load: the right one; or, of loads weighed in parts, as on two trucks, a column `part` with 1, 2, ..."


def with_parts_added(tickets: Iterable[tuple[WeighedTicket, Sequence[Load]]]) -> list[tuple[WeighedTicket, tuple[Load, ...]]]:
    """One ticket for each load, in order.

    Parameters
    ----------
    tickets : iterable of (WeighedTicket, sequence)
        Each with the loads that it is for.

    Returns
    -------
    list of (WeighedTicket, tuple)
        Parts of the same loads as one ticket of their sum: errors of the weighings are independent, those by another combine's
        monitor are one error.

    Raises
    ------
    InputError
        For a load that two rows weigh which are not marked as parts, or are the same part or parts of different loads.
    """
    found: list[tuple[WeighedTicket, tuple[Load, ...]]] = []
    place: dict[Load, int] = {}
    parts: dict[int, set[str]] = {}
    for ticket, of in tickets:
        loads = tuple(of)
        at = next((place[load] for load in loads if load in place), None)
        if at is None:
            place |= dict.fromkeys(loads, len(found))
            parts[len(found)] = {ticket.part}
            found.append((ticket, loads))
            continue
        first, known = found[at]
        if not ticket.part or "" in parts[at] or ticket.part in parts[at] or set(loads) != set(known):
            raise InputError(ticket.where, _problem(ticket, first, same=set(loads) == set(known), parts=parts[at]), ONE_ROW)
        parts[at].add(ticket.part)
        found[at] = _added(first, ticket), known
    return found


def _problem(ticket: WeighedTicket, first: WeighedTicket, *, same: bool, parts: set[str]) -> str:
    if same and ticket.part and ticket.part in parts:
        return f"load {ticket.name} has its part {ticket.part} already ({first.line})"
    shares = "" if same else f", as part of {first.name}"
    return f"load {ticket.name} has a ticket already ({first.line}{shares})"


def _added(one: WeighedTicket, other: WeighedTicket) -> WeighedTicket:
    common_kg = one.other_std_dev_kg + other.other_std_dev_kg
    apart = sum(ticket.std_dev_kg**2 - ticket.other_std_dev_kg**2 for ticket in (one, other))
    return replace(
        one,
        mass_kg=one.mass_kg + other.mass_kg,
        std_dev_kg=sqrt(max(apart, 0.0) + common_kg**2),
        other_std_dev_kg=common_kg,
    )
