"""What became of each ticket, in the words that lists of tickets show."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from yieldmon.service.storage import ledger as ledgers
from yieldmon.service.storage.batch import Action

_CORRECTS = "corrects its load"
_CONTRADICTS = "contradicts those before it, counts when another agrees"


def ticket_states(
    ledger: ledgers.Ledger, actions: Sequence[Action], *, to_update: Mapping[int, str], doubted_loads: Collection[int] = ()
) -> dict[int, str]:
    """The state of each ticket that stands, by its number.

    Parameters
    ----------
    ledger : Ledger
        Tickets that stand.
    actions : sequence of Action
        All that was entered, updated and taken back, in order.
    to_update : mapping
        Tickets that are still to update the parameters, with the crop whose return they wait for, "" where it is harvested now.
    doubted_loads : collection of int
        Loads whose tickets contradict those that count.

    Returns
    -------
    dict
    """
    updated, silenced = _versions(actions), ledgers.silenced(actions)
    newest, replaced_ones = ledger.newest, ledger.replaced
    states = {}
    for number, ticket in ledger.tickets.items():
        if number in to_update:
            of_crop = f" of {to_update[number]}" if to_update[number] else ""
            state = f"to update the parameters{of_crop}"
        elif number in updated:
            state = f"updated the parameters to version {updated[number]}"
        elif number in silenced:
            state = "corrects its load, updates no parameters"
        elif any(load in doubted_loads for load in ticket.loads):
            state = _CONTRADICTS
        else:
            state = _CORRECTS
        if number in replaced_ones:
            newer = {newest[load] for load in ticket.loads} - {number}
            replaced = f"replaced by ticket {', '.join(map(str, sorted(newer)))}"
            state = replaced if state in (_CORRECTS, _CONTRADICTS) else f"{state}, {replaced}"
        states[number] = state
    return states


def _versions(actions: Sequence[Action]) -> dict[int, int]:
    """The first version that stands of those that each ticket has led to, by the ticket's number."""
    gone, led = ledgers.undone_versions(actions), ledgers.updated_by(actions)
    pairs = ((number, version) for version, numbers in led.items() if version not in gone for number in numbers)
    return dict(sorted(pairs, reverse=True))
